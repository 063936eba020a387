// The page in the browser: it draws what it is sent, and says what the person wants.
import { connect } from "./wire.js";
import * as asking from "./asking.js";
import * as curves from "./curves.js";
import * as jog from "./jog.js";
import * as picture from "./picture.js";
import * as poses from "./poses.js";
import * as settings from "./settings.js";
import * as scene from "./scene.js";
import * as runs from "./runs.js";
import * as state from "./state.js";
import * as tour from "./tour.js";
import * as trouble from "./trouble.js";

const rcm = connect(window.RCMSERVO);
window.rcm = rcm;
const parts = [state, asking, picture, poses, tour, jog, settings, curves, scene, runs, trouble];
for (const part of parts) part.start(rcm);
