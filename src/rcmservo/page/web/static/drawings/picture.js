// Live picture with its overlay: tool blue, target black, as in the paper's figures.
import { rcm } from "../connection.js";
import { drawFeatures } from "./feature_overlay.js";
import {
  drawPath, drawPrediction, drawText, isDrawable, isKnown, BLACK, BLUE, YELLOW,
} from "./outlined_strokes.js";

let receivedCount = 0, displayedNumber = 0;

rcm.onBoard((board, jpeg) => { if (jpeg.byteLength > 0) display(board, jpeg, ++receivedCount); });

async function display(board, jpeg, number) {
  const image = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
  const canvas = document.getElementById("picture");
  if (!canvas || number < displayedNumber) return image.close(); // a later one was decoded sooner
  displayedNumber = number;
  drawPicture(canvas, image, board);
  image.close();
  rcm.drawn += 1;
}

// Draw an image with the overlay of a board, the page's content at the time of the image.
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

// Draw the line from the imaged RCM through both markers, and a circle with a name at each marker.
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

// Draw a cross at the imaged RCM. If it lies outside the picture, draw an arrowhead at the border.
function drawRcm(context, o_c, canvas, size) {
  if (!isKnown(o_c)) return;
  const [u, v] = o_c, arm = 14 * size; // length of the strokes
  if (u >= 0 && u < canvas.width && v >= 0 && v < canvas.height) {
    drawPath(context, YELLOW, size, () => {
      context.moveTo(u - arm, v - arm); context.lineTo(u + arm, v + arm);
      context.moveTo(u + arm, v - arm); context.lineTo(u - arm, v + arm);
    });
    return;
  }
  const uCentre = canvas.width / 2, vCentre = canvas.height / 2;
  const du = u - uCentre, dv = v - vCentre, angle = Math.atan2(dv, du);
  const fraction = Math.min((uCentre - arm) / Math.abs(du), (vCentre - arm) / Math.abs(dv));
  const uTip = uCentre + fraction * du, vTip = vCentre + fraction * dv;
  drawPath(context, YELLOW, size, () => {
    for (const barbAngle of [angle + 2.6, angle - 2.6]) {
      context.moveTo(uTip, vTip);
      context.lineTo(uTip + arm * Math.cos(barbAngle), vTip + arm * Math.sin(barbAngle));
    }
  });
}
