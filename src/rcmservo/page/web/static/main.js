// What the page draws beside the parts that NiceGUI places: pictures, curves and the mechanism; and
// STOP.
import { rcm } from "./wire.js";
import "./stop.js";
import * as curves from "./curves.js";
import * as picture from "./picture.js";
import * as scene from "./scene.js";

for (const part of [picture, curves, scene]) part.start(rcm);
