// NiceGUI's object of an element of the page; undefined before it exists.
export function niceguiElement(id) {
  try {
    return window.getElement(id);
  } catch {
    return undefined; // NiceGUI raises an error while it builds the page
  }
}
