// The features on the picture: s is the tool's angle, r the way from the imaged RCM to m₁, d that
// from m₁ to m₂.
import { known, stroke, words, BLUE, WHITE } from "./pen.js";

const ARC = 26, HEIGHT = 13; // px of a picture that is 640 px wide

export function features(pen, board, size) {
  const { points, y } = board;
  if (!known(y) || !points.every(known)) return;
  const [s, r, d] = y, [[u1, v1], [u2, v2]] = points;
  const thin = [[WHITE, 2.5], [BLUE, 1.2]];
  pen.setLineDash([3 * size, 3 * size]);
  stroke(pen, BLUE, size, () => {
    pen.moveTo(u1, v1);
    pen.lineTo(u1 + 1.6 * ARC * size, v1);
  }, thin);
  pen.setLineDash([]);
  stroke(pen, BLUE, size, () => pen.arc(u1, v1, ARC * size, 0, s, s < 0), thin);
  // beside the tool, on the side to which the angle does not open
  const side = s < 0 ? -1 : 1, along = [Math.cos(s), Math.sin(s)];
  const at = (share, off) => [
    u1 + share * (u2 - u1) - side * off * along[1] * size,
    v1 + share * (v2 - v1) + side * off * along[0] * size,
  ];
  const say = (text, [u, v], align) => {
    pen.textAlign = align;
    words(pen, text, u, v + 0.35 * HEIGHT * size, BLUE, HEIGHT * size);
  };
  const beside = side * along[1] > 0 ? "right" : "left";
  const degrees = s * 180 / Math.PI;
  say(`s ${degrees.toFixed(1)}°`, [u1 + 1.8 * ARC * size, v1], "left");
  say(`d ${d.toFixed(0)} px`, at(0.6, 22), beside);
  say(`r ${r.toFixed(0)} px`, at(-0.35, 22), beside);
  pen.textAlign = "left";
}
