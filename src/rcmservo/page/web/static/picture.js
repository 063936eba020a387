// The picture, with the tool blue and the target black, as in the paper's figures.
import { ghost, known, near, stroke, words, BLACK, BLUE, YELLOW } from "./pen.js";
import { features } from "./features.js";

let asked = 0, shown = 0;

export function start(rcm) {
  rcm.told((board, jpeg) => { if (jpeg.byteLength > 0) draw(rcm, board, jpeg, ++asked); });
}

async function draw(rcm, board, jpeg, turn) {
  const image = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
  const canvas = document.getElementById("picture");
  if (!canvas || turn < shown) return image.close(); // a later one was ready sooner
  shown = turn;
  paint(canvas, image, board);
  image.close();
  rcm.drawn += 1;
}

// A picture with what is known of it drawn on it.
export function paint(canvas, image, board) {
  if (canvas.width !== image.width || canvas.height !== image.height) {
    canvas.width = image.width;
    canvas.height = image.height;
  }
  const pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0);
  const size = canvas.width / 640;
  if (board.target) tool(pen, board.target, board.rcm, BLACK, size, ["", ""]);
  if (board.ghost) board.ghost.filter(known).forEach((point) => ghost(pen, point, size));
  if (board.points) {
    tool(pen, board.points, board.rcm, BLUE, size, ["m₁", "m₂"].map((name, i) => {
      const quality = board.quality ? board.quality[i] : null;
      return quality === null ? name : `${name} ${(100 * quality).toFixed(0)} %`;
    }));
    features(pen, board, size);
  }
  rcmMark(pen, board.rcm, canvas, size);
}
function tool(pen, points, o_c, colour, size, names) {
  const way = [known(o_c) && near(o_c) ? o_c : null, ...points].filter(known);
  stroke(pen, colour, size, () => {
    way.forEach(([u, v], i) => (i ? pen.lineTo(u, v) : pen.moveTo(u, v)));
  });
  points.forEach((point, i) => {
    if (!known(point)) return;
    const [u, v] = point;
    stroke(pen, colour, size, () => pen.arc(u, v, 9 * size, 0, 2 * Math.PI));
    words(pen, names[i], u + 12 * size, v - 8 * size, colour, 14 * size);
  });
}
function rcmMark(pen, o_c, canvas, size) {
  if (!known(o_c)) return;
  const [u, v] = o_c, m = 14 * size;
  if (u >= 0 && u < canvas.width && v >= 0 && v < canvas.height) {
    stroke(pen, YELLOW, size, () => {
      pen.moveTo(u - m, v - m); pen.lineTo(u + m, v + m);
      pen.moveTo(u + m, v - m); pen.lineTo(u - m, v + m);
    });
    return;
  }
  // outside: an arrow at the border, from the picture's middle towards it
  const x = canvas.width / 2, y = canvas.height / 2;
  const share = Math.min((x - m) / Math.abs(u - x), (y - m) / Math.abs(v - y));
  const turn = Math.atan2(v - y, u - x), a = x + share * (u - x), b = y + share * (v - y);
  stroke(pen, YELLOW, size, () => {
    for (const side of [2.6, -2.6]) {
      pen.moveTo(a, b);
      pen.lineTo(a + m * Math.cos(turn + side), b + m * Math.sin(turn + side));
    }
  });
}
