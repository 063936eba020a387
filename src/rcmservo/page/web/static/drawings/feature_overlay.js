// Features y = (s, r, d) on the picture: the angle s of the tool, the distance r from the imaged
// RCM to marker m₁, and the distance d from m₁ to m₂.
import { drawPath, drawText, isKnown, BLUE, WHITE } from "./outlined_strokes.js";

const ARC_PX = 26, TEXT_HEIGHT_PX = 13; // on a picture that is 640 px wide

// Draw arc and labels. `size` is the width of the picture divided by 640 px.
export function drawFeatures(context, board, size) {
  const { points, y } = board;
  if (!isKnown(y) || !points.every(isKnown)) return;
  const [s, r, d] = y, [[u1, v1], [u2, v2]] = points;
  const thinStrokes = [[WHITE, 2.5], [BLUE, 1.2]];
  context.setLineDash([3 * size, 3 * size]);
  drawPath(context, BLUE, size, () => {
    context.moveTo(u1, v1);
    context.lineTo(u1 + 1.6 * ARC_PX * size, v1);
  }, thinStrokes);
  context.setLineDash([]);
  drawPath(context, BLUE, size, () => context.arc(u1, v1, ARC_PX * size, 0, s, s < 0), thinStrokes);
  // The labels of r and d stand next to the tool, on the side opposite to the arc.
  const side = s < 0 ? -1 : 1, toolDirection = [Math.cos(s), Math.sin(s)];
  const pointNextToTool = (fraction, offset) => [
    u1 + fraction * (u2 - u1) - side * offset * toolDirection[1] * size,
    v1 + fraction * (v2 - v1) + side * offset * toolDirection[0] * size,
  ];
  const drawLabel = (text, [u, v], align) => {
    context.textAlign = align;
    drawText(context, text, u, v + 0.35 * TEXT_HEIGHT_PX * size, BLUE, TEXT_HEIGHT_PX * size);
  };
  const align = side * toolDirection[1] > 0 ? "right" : "left";
  const degrees = s * 180 / Math.PI;
  drawLabel(`s ${degrees.toFixed(1)}°`, [u1 + 1.8 * ARC_PX * size, v1], "left");
  drawLabel(`d ${d.toFixed(0)} px`, pointNextToTool(0.6, 22), align);
  drawLabel(`r ${r.toFixed(0)} px`, pointNextToTool(-0.35, 22), align);
  context.textAlign = "left";
}
