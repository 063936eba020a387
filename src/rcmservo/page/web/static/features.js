// Features on the picture: s is the angle of the tool, r the distance from the imaged RCM to m₁,
// d the distance from m₁ to m₂.
import { drawPath, drawText, isKnown, BLUE, WHITE } from "./drawing.js";

const ARC_PX = 26, TEXT_HEIGHT_PX = 13; // on a picture that is 640 px wide

export function drawFeatures(context, board, size) {
  const { points, y } = board;
  if (!isKnown(y) || !points.every(isKnown)) return;
  const [s, r, d] = y, [[u1, v1], [u2, v2]] = points;
  const thin = [[WHITE, 2.5], [BLUE, 1.2]];
  context.setLineDash([3 * size, 3 * size]);
  drawPath(context, BLUE, size, () => {
    context.moveTo(u1, v1);
    context.lineTo(u1 + 1.6 * ARC_PX * size, v1);
  }, thin);
  context.setLineDash([]);
  drawPath(context, BLUE, size, () => context.arc(u1, v1, ARC_PX * size, 0, s, s < 0), thin);
  // next to the tool, on the side opposite to the arc
  const side = s < 0 ? -1 : 1, along = [Math.cos(s), Math.sin(s)];
  const at = (fraction, offset) => [
    u1 + fraction * (u2 - u1) - side * offset * along[1] * size,
    v1 + fraction * (v2 - v1) + side * offset * along[0] * size,
  ];
  const label = (text, [u, v], align) => {
    context.textAlign = align;
    drawText(context, text, u, v + 0.35 * TEXT_HEIGHT_PX * size, BLUE, TEXT_HEIGHT_PX * size);
  };
  const align = side * along[1] > 0 ? "right" : "left";
  const degrees = s * 180 / Math.PI;
  label(`s ${degrees.toFixed(1)}°`, [u1 + 1.8 * ARC_PX * size, v1], "left");
  label(`d ${d.toFixed(0)} px`, at(0.6, 22), align);
  label(`r ${r.toFixed(0)} px`, at(-0.35, 22), align);
  context.textAlign = "left";
}
