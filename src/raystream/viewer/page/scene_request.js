// Requests the packed scene of this page's connection.

/** The bytes of the scene; an error has the server's reason. */
export async function loadScene(key) {
  let answer;
  try {
    answer = await fetch(new URL("scene", document.baseURI), {headers: {"X-Upload-Key": key}});
  } catch {
    throw new Error("The scene could not be loaded: no connection to raystream.");
  }
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return new Uint8Array(await answer.arrayBuffer());
}
