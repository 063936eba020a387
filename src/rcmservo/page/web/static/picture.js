// The picture, with the tool blue and the target black, as in the paper's figures.
const BLUE = "#005aff", BLACK = "#000000", WHITE = "#ffffff", YELLOW = "#ffdc00";

export function start(rcm) {
  rcm.told((board, jpeg) => { if (jpeg.byteLength > 0) draw(rcm, board, jpeg); });
}

async function draw(rcm, board, jpeg) {
  const image = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
  const canvas = document.getElementById("picture");
  if (!canvas) return;
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
  if (board.points) tool(pen, board.points, board.rcm, BLUE, size, ["m₁", "m₂"]);
  rcmMark(pen, board.rcm, canvas, size);
}
function known(point) {
  return Array.isArray(point) && point.every((one) => one !== null);
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
    pen.font = `${14 * size}px sans-serif`;
    pen.lineWidth = 3 * size;
    pen.strokeStyle = WHITE;
    pen.strokeText(names[i], u + 12 * size, v - 8 * size);
    pen.fillStyle = colour;
    pen.fillText(names[i], u + 12 * size, v - 8 * size);
  });
}
function stroke(pen, colour, size, path) {
  for (const [ink, width] of [[WHITE, 4], [colour, 2]]) {
    pen.beginPath();
    path();
    pen.strokeStyle = ink;
    pen.lineWidth = width * size;
    pen.stroke();
  }
}
const near = ([u, v]) => Math.abs(u) < 20000 && Math.abs(v) < 20000;
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
