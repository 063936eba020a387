// What NiceGUI has made of an element of the page; undefined before it is there.
export function made(id) {
  try {
    return window.getElement(id);
  } catch {
    return undefined; // it answers with an error while the page is built
  }
}
