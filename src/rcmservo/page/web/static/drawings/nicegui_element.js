// Return NiceGUI's object of the element with this number, or undefined before it exists.
export function findNiceguiElement(id) {
  try {
    return window.getElement(id);
  } catch {
    return undefined; // NiceGUI raises an error while it builds the page
  }
}
