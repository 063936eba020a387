// Lines, circles and text on a canvas, with a white outline that keeps them legible on any picture.
// `size` is the width of the picture divided by 640 px.
export const BLUE = "#005aff", BLACK = "#000000", WHITE = "#ffffff", YELLOW = "#ffdc00";
const MAX_COORDINATE_PX = 20000;

export function isKnown(point) {
  return Array.isArray(point) && point.every((coordinate) => coordinate !== null);
}

export const isDrawable = ([u, v]) =>
  Math.abs(u) < MAX_COORDINATE_PX && Math.abs(v) < MAX_COORDINATE_PX;

// Stroke the path that `addPath` adds to the context, once for each pair of colour and line width.
export function drawPath(context, colour, size, addPath, strokes = [[WHITE, 4], [colour, 2]]) {
  for (const [strokeColour, width] of strokes) {
    context.beginPath();
    addPath();
    context.strokeStyle = strokeColour;
    context.lineWidth = width * size;
    context.stroke();
  }
}

export function drawText(context, text, u, v, colour, height) {
  context.font = `${height}px sans-serif`;
  context.lineWidth = height / 5;
  context.strokeStyle = WHITE;
  context.strokeText(text, u, v);
  context.fillStyle = colour;
  context.fillText(text, u, v);
}

// Draw a dashed circle at a predicted marker.
export function drawPrediction(context, [u, v], size) {
  if (!isDrawable([u, v])) return;
  context.setLineDash([4 * size, 3 * size]);
  drawPath(context, BLUE, size, () => context.arc(u, v, 14 * size, 0, 2 * Math.PI),
    [[WHITE, 2.5], [BLUE, 1.2]]);
  context.setLineDash([]);
}
