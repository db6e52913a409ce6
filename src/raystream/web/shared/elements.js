// Helpers to find and make elements of the page.

export const byId = id => document.getElementById(id);

/** Make an element with a class, text or children. */
export function make(tag, className = "", content = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (Array.isArray(content)) element.append(...content);
  else element.textContent = content;
  return element;
}

/** Fill a select with [value, text] pairs; keeps the selection if it still exists. */
export function fillSelect(select, choices) {
  const said = JSON.stringify(choices);
  if (select.dataset.choices === said) return;
  select.dataset.choices = said;
  const chosen = select.value;
  select.replaceChildren(...choices.map(([value, text]) => new Option(text, value)));
  if (choices.some(([value]) => value === chosen)) select.value = chosen;
}

/** Fill a list of terms and figures, updating only what changed. */
export function fillFigures(list, rows) {
  const names = rows.map(([name]) => name).join("\n");
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...rows.flatMap(([name]) => [make("dt", "", name), make("dd")]));
  }
  rows.forEach(([, text, title], index) => {
    const figure = list.children[2 * index + 1];
    if (figure.textContent !== text) figure.textContent = text;
    if (title && figure.title !== title) figure.title = title;
  });
}
