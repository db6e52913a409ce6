// A click on the image of a live page loads the page in its place. Without this script, and with
// a key that opens links in another tab, the link leads to the page.

document.addEventListener("click", event => {
  const link = event.target.closest?.("a.live-open");
  if (!link || event.button || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  const frame = document.createElement("iframe");
  frame.src = link.href;
  frame.title = link.dataset.title;
  frame.allowFullscreen = true;
  link.replaceWith(frame);
  frame.focus();
});
