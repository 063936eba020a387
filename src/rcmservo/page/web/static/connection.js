// What goes to the server and comes from it.
//
// view           what the parts of the page show; they are drawn anew as it changes
// can(what)      whether a press may say so now
// rcm.board      what was told last
// rcm.told(f)    have f(board, jpeg) called with all that is told from now on
// rcm.changed(f) have f() called when there may be something to show anew
// rcm.say(m)     say a message, which counts while rcm.board is fresh
// rcm.want(w, m) say what a press wants, and more of it, once rcm.board is fresh
// rcm.forget()   say no more for a press that waits
// rcm.url(path)  where something can be fetched
import { shallowReactive } from "vue";

const AGAIN = 500, FRESH = 200, PRESSED = 500, SHOWN = 80, AT_LEAST = 250, LATELY = 10000; // ms
export const UNHEARD = "STOP was not heard: use the emergency stop of the arm";

export const view = shallowReactive({
  board: {}, connected: false, may: false, holds: false, asked: false, refused: "", stopWords: "",
  stopReady: false,
});

export const can = (what) => {
  if (what === "ask") return view.connected && !view.holds;
  if (what === "give") return view.may && view.asked;
  return view.may && (view.board.can || []).includes(what);
};

function connect(site) {
  const listeners = [], showers = [];
  const rcm = { drawn: 0, board: {}, name: "", holds: false, asked: false, refused: "", heard: 0,
    stopWords: "", jogs: () => false, letGo: () => {} };
  const secret = encodeURIComponent(site.secret);
  rcm.url = (path) => `${path}${path.includes("?") ? "&" : "?"}secret=${secret}`;
  rcm.told = (f) => listeners.push(f);
  rcm.changed = (f) => showers.push(f);
  let shown = 0;
  const show = () => {
    shown = performance.now();
    const { board, holds, asked, refused, stopWords } = rcm;
    Object.assign(view, { board, holds, asked, refused, stopWords, connected: rcm.connected(),
      may: rcm.may(), stopReady: rcm.stopLine.wire !== null });
    for (const f of showers) f();
  };
  rcm.show = show;

  // A websocket that is opened again whenever it is gone.
  function line(path, port, opened, heard) {
    const it = { wire: null };
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const open = () => {
      const wire = new WebSocket(`${scheme}://${location.hostname}:${port}${rcm.url(path)}`);
      wire.binaryType = "arraybuffer";
      wire.onopen = () => { it.wire = wire; opened(wire); };
      wire.onmessage = (event) => heard(event.data, wire);
      wire.onclose = () => { it.wire = null; show(); setTimeout(open, AGAIN); };
    };
    it.say = (words) => {
      const ready = it.wire !== null && it.wire.readyState === WebSocket.OPEN;
      if (ready) it.wire.send(words);
      return ready;
    };
    open();
    return it;
  }

  rcm.stopLine = line("/stop", site.stopPort, show, (words) => {
    rcm.stopWords = words === "heard" ? "" : UNHEARD;
    show();
  });
  const operate = line("/operate", location.port, show, (words) => {
    const answer = JSON.parse(words);
    if (answer.name) rcm.name = answer.name;
    if (answer.refused) rcm.refused = answer.refused;
    show();
  });
  const pictures = line("/pictures", location.port, (wire) => wire.send("next"), (data, wire) => {
    wire.send("next");
    rcm.heard = performance.now();
    const length = new DataView(data).getUint32(0, true);
    rcm.board = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    rcm.holds = rcm.name !== "" && rcm.board.holder === rcm.name;
    rcm.asked = Boolean(rcm.board.asking);
    const jpeg = data.slice(4 + length);
    clocked();
    sayPressed();
    for (const f of listeners) f(rcm.board, jpeg);
    if (rcm.heard - shown > SHOWN) show();
  });
  setInterval(show, AT_LEAST);

  // How old what was told last is now, against what came quickest of late: a board that lay in a
  // queue while the browser was busy is heard now, and tells of then.
  let quickest = Infinity, before = Infinity, begun = 0;
  const since = () => performance.now() - 1e-6 * rcm.board.at;
  const age = () => since() - Math.min(quickest, before);
  function clocked() {
    if (rcm.heard - begun > LATELY) [before, quickest, begun] = [quickest, Infinity, rcm.heard];
    quickest = Math.min(quickest, since());
  }

  rcm.say = (message) => operate.say(JSON.stringify({ ...message, at: rcm.board.at }));
  // A press counts once what is shown is of now: a browser that was busy waits for the next board,
  // but not for long.
  let pressed = null;
  const sayPressed = () => {
    if (pressed === null) return;
    const late = performance.now() - pressed.since > PRESSED;
    if (!late && !(age() < FRESH)) return;
    if (late) rcm.refused = "this browser was busy: press again";
    else rcm.say(pressed.message);
    pressed = null;
  };
  rcm.want = (what, more = {}) => {
    rcm.refused = "";
    pressed = { message: { do: what, ...more }, since: performance.now() };
    sayPressed();
  };
  rcm.forget = () => { pressed = null; };
  rcm.connected = () =>
    performance.now() - rcm.heard < 1000 && pictures.wire !== null && operate.wire !== null;
  rcm.may = () => rcm.connected() && rcm.holds && rcm.stopLine.wire !== null;
  return rcm;
}

export const rcm = connect(window.RCMSERVO);
window.rcm = rcm;
