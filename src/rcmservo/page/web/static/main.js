// Modules that draw on elements of the page (picture, curves, 3-D scene), and STOP.
import { rcm } from "./connection.js";
import "./stop.js";
import * as curves from "./curves.js";
import * as picture from "./picture.js";
import * as scene from "./scene.js";

for (const module of [picture, curves, scene]) module.start(rcm);
