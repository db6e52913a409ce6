// What the fragment of a page's address chooses, such as page.html#structure=grid&mode=whitted;
// machine=passes, too.

import {byId} from "./elements.js";

const CHOICES = ["structure", "mode", "machine"];

/** Choose what the address names, where the page has it. */
export function chooseByAddress(page) {
  const named = new URLSearchParams(location.hash.slice(1));
  for (const name of CHOICES) {
    const value = named.get(name);
    const has = option => option.value === value && !option.disabled;
    if ([...byId(name).options].some(has)) page.choose(name, value);
  }
}
