// How lines, circles and words are drawn on the picture, so that they can be read on any of it.
export const BLUE = "#005aff", BLACK = "#000000", WHITE = "#ffffff", YELLOW = "#ffdc00";

export function known(point) {
  return Array.isArray(point) && point.every((one) => one !== null);
}
export const near = ([u, v]) => Math.abs(u) < 20000 && Math.abs(v) < 20000;

export function stroke(pen, colour, size, path, inks = [[WHITE, 4], [colour, 2]]) {
  for (const [ink, width] of inks) {
    pen.beginPath();
    path();
    pen.strokeStyle = ink;
    pen.lineWidth = width * size;
    pen.stroke();
  }
}

export function words(pen, text, u, v, colour, height) {
  pen.font = `${height}px sans-serif`;
  pen.lineWidth = height / 5;
  pen.strokeStyle = WHITE;
  pen.strokeText(text, u, v);
  pen.fillStyle = colour;
  pen.fillText(text, u, v);
}

// Where the servo expects a marker.
export function ghost(pen, [u, v], size) {
  if (!near([u, v])) return;
  pen.setLineDash([4 * size, 3 * size]);
  stroke(pen, BLUE, size, () => pen.arc(u, v, 14 * size, 0, 2 * Math.PI),
    [[WHITE, 2.5], [BLUE, 1.2]]);
  pen.setLineDash([]);
}
