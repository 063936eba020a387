// The page in the browser: it draws what it is sent, and says what the person wants.
import { connect } from "./wire.js";
import * as jog from "./jog.js";
import * as picture from "./picture.js";
import * as poses from "./poses.js";
import * as state from "./state.js";
import * as trouble from "./trouble.js";

const rcm = connect(window.RCMSERVO);
window.rcm = rcm;
for (const part of [state, picture, poses, jog, trouble]) part.start(rcm);
