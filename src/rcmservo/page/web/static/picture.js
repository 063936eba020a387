// Live picture with its overlay: tool blue, target black, as in the paper's figures.
import {
  drawPath, drawPrediction, drawText, isDrawable, isKnown, BLACK, BLUE, YELLOW,
} from "./drawing.js";
import { drawFeatures } from "./features.js";

let newest = 0, displayed = 0;

export function start(rcm) {
  rcm.onBoard((board, jpeg) => { if (jpeg.byteLength > 0) display(rcm, board, jpeg, ++newest); });
}

async function display(rcm, board, jpeg, number) {
  const image = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
  const canvas = document.getElementById("picture");
  if (!canvas || number < displayed) return image.close(); // a later one was decoded sooner
  displayed = number;
  drawPicture(canvas, image, board);
  image.close();
  rcm.drawn += 1;
}

// Draw an image with the overlay of a board.
export function drawPicture(canvas, image, board) {
  if (canvas.width !== image.width || canvas.height !== image.height) {
    canvas.width = image.width;
    canvas.height = image.height;
  }
  const context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const size = canvas.width / 640;
  if (board.target) drawTool(context, board.target, board.rcm, BLACK, size, ["", ""]);
  if (board.predicted) {
    board.predicted.filter(isKnown).forEach((point) => drawPrediction(context, point, size));
  }
  if (board.points) {
    drawTool(context, board.points, board.rcm, BLUE, size, ["m₁", "m₂"].map((name, i) => {
      const quality = board.quality ? board.quality[i] : null;
      return quality === null ? name : `${name} ${(100 * quality).toFixed(0)} %`;
    }));
    drawFeatures(context, board, size);
  }
  drawRcm(context, board.rcm, canvas, size);
}
function drawTool(context, points, o_c, colour, size, names) {
  const vertices = [isKnown(o_c) && isDrawable(o_c) ? o_c : null, ...points].filter(isKnown);
  drawPath(context, colour, size, () => {
    vertices.forEach(([u, v], i) => (i ? context.lineTo(u, v) : context.moveTo(u, v)));
  });
  points.forEach((point, i) => {
    if (!isKnown(point)) return;
    const [u, v] = point;
    drawPath(context, colour, size, () => context.arc(u, v, 9 * size, 0, 2 * Math.PI));
    drawText(context, names[i], u + 12 * size, v - 8 * size, colour, 14 * size);
  });
}
function drawRcm(context, o_c, canvas, size) {
  if (!isKnown(o_c)) return;
  const [u, v] = o_c, m = 14 * size;
  if (u >= 0 && u < canvas.width && v >= 0 && v < canvas.height) {
    drawPath(context, YELLOW, size, () => {
      context.moveTo(u - m, v - m); context.lineTo(u + m, v + m);
      context.moveTo(u + m, v - m); context.lineTo(u - m, v + m);
    });
    return;
  }
  // outside the picture: an arrow at the border, from the centre towards the imaged RCM
  const x = canvas.width / 2, y = canvas.height / 2;
  const fraction = Math.min((x - m) / Math.abs(u - x), (y - m) / Math.abs(v - y));
  const angle = Math.atan2(v - y, u - x), a = x + fraction * (u - x), b = y + fraction * (v - y);
  drawPath(context, YELLOW, size, () => {
    for (const side of [2.6, -2.6]) {
      context.moveTo(a, b);
      context.lineTo(a + m * Math.cos(angle + side), b + m * Math.sin(angle + side));
    }
  });
}
