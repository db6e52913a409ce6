// The packed data of a page: in the page itself, or in a file beside it.

import {PageError} from "./pack.js";

const FROM_DISK = "Browsers open this page from a web server only: run "
  + "\"python -m http.server\" in its folder, or export it without --split, as one file.";

/** Base64 in an element, or the bytes of the file that it names. */
export async function dataOf(element) {
  const {file} = element.dataset;
  if (!file) return element.textContent;
  let answer;
  try {
    answer = await fetch(file);
  } catch {
    throw new PageError(location.protocol === "file:" ? FROM_DISK
      : "The server did not answer with this page's data; reload the page to try again.");
  }
  if (!answer.ok) {
    throw new PageError(`The server has no ${file.split("?")[0]} (${answer.status}): all files of `
      + "the page's folder belong together.");
  }
  return new Uint8Array(await answer.arrayBuffer());
}
