// What the fragment of a page's address chooses, such as page.html#structure=grid&mode=whitted.

import {byId} from "./elements.js";

const CHOICES = ["structure", "mode"];

/** Choose what the address names, where the page has it. */
export function chooseByAddress(page) {
  const named = new URLSearchParams(location.hash.slice(1));
  for (const name of CHOICES) {
    const value = named.get(name);
    if (![...byId(name).options].some(option => option.value === value)) continue;
    byId(name).value = page[name] = value;
  }
}
