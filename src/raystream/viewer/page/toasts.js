// Toasts: short messages that disappear on their own, and are read by screen readers.

const LIFE = 7000;
const MOST = 4;

export class Toasts {
  constructor(list) {
    this.list = list;
  }

  /** Show a message; errors stay longer. */
  show(text, kind = "note") {
    for (const old of this.list.children) {
      if (old.firstChild.textContent === text) old.remove();
    }
    const toast = document.createElement("div");
    toast.className = `toast ${kind}`;
    const words = document.createElement("p");
    words.textContent = text;
    const close = document.createElement("button");
    close.type = "button";
    close.className = "bare";
    close.setAttribute("aria-label", "Dismiss");
    close.textContent = "×";
    toast.append(words, close);
    this.list.append(toast);
    while (this.list.children.length > MOST) this.list.firstChild.remove();
    let timer = null;
    const stay = () => clearTimeout(timer);
    const leave = () => {
      stay();
      timer = setTimeout(() => toast.remove(), kind === "error" ? 2 * LIFE : LIFE);
    };
    close.onclick = () => toast.remove();
    toast.onpointerenter = stay;
    toast.onpointerleave = leave;
    toast.onfocusin = stay;
    toast.onfocusout = leave;
    leave();
  }

  error(text) {
    this.show(text, "error");
  }
}
