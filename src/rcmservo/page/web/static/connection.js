// Connection to the server: websockets for pictures, requests and STOP.
//
// view             reactive state that the components display
// can(action)      whether the user may request an action now
// rcm.board        newest content of the page
// rcm.onBoard(f)   call f(board, jpeg) with each new content
// rcm.onChange(f)  call f() whenever the displayed state may have changed
// rcm.send(m)      send a message; it counts while rcm.board is fresh
// rcm.request(action, more)  send a request with its arguments once rcm.board is fresh
// rcm.cancelRequest()        discard a request that waits
// rcm.url(path)    address of the server's data
import { shallowReactive } from "vue";

const RECONNECT_MS = 500, MAX_AGE_MS = 200, MAX_REQUEST_WAIT_MS = 500, MIN_REFRESH_MS = 80;
const MAX_REFRESH_MS = 250, DELAY_WINDOW_MS = 10000, CONNECTION_TIMEOUT_MS = 1000;
export const STOP_FAILED = "STOP did not arrive: use the emergency stop of the arm";

export const view = shallowReactive({
  board: {}, connected: false, may: false, holds: false, requested: false, refused: "",
  stopStatus: "", stopReady: false,
});

export const can = (action) => {
  if (action === "request_control") return view.connected && !view.holds;
  if (action === "hand_over") return view.may && view.requested;
  return view.may && (view.board.can || []).includes(action);
};

function connect(site) {
  const boardListeners = [], changeListeners = [];
  const rcm = { drawn: 0, board: {}, name: "", holds: false, requested: false, refused: "",
    receivedAt: 0, stopStatus: "", jogs: () => false, releaseJog: () => {} };
  const secret = encodeURIComponent(site.secret);
  rcm.url = (path) => `${path}${path.includes("?") ? "&" : "?"}secret=${secret}`;
  rcm.onBoard = (f) => boardListeners.push(f);
  rcm.onChange = (f) => changeListeners.push(f);
  let refreshedAt = 0;
  const refresh = () => {
    refreshedAt = performance.now();
    const { board, holds, requested, refused, stopStatus } = rcm;
    Object.assign(view, { board, holds, requested, refused, stopStatus,
      connected: rcm.connected(), may: rcm.may(), stopReady: rcm.stopLine.socket !== null });
    for (const f of changeListeners) f();
  };
  rcm.refresh = refresh;

  // A websocket that reconnects after it was closed.
  function openLine(path, port, opened, received) {
    const line = { socket: null };
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const open = () => {
      const socket = new WebSocket(`${scheme}://${location.hostname}:${port}${rcm.url(path)}`);
      socket.binaryType = "arraybuffer";
      socket.onopen = () => { line.socket = socket; opened(socket); };
      socket.onmessage = (event) => received(event.data, socket);
      socket.onclose = () => { line.socket = null; refresh(); setTimeout(open, RECONNECT_MS); };
    };
    line.send = (text) => {
      const ready = line.socket !== null && line.socket.readyState === WebSocket.OPEN;
      if (ready) line.socket.send(text);
      return ready;
    };
    open();
    return line;
  }

  rcm.stopLine = openLine("/stop", site.stopPort, refresh, (text) => {
    rcm.stopStatus = text === "heard" ? "" : STOP_FAILED;
    refresh();
  });
  const operate = openLine("/operate", location.port, refresh, (text) => {
    const answer = JSON.parse(text);
    if (answer.name) rcm.name = answer.name;
    if (answer.refused) rcm.refused = answer.refused;
    refresh();
  });
  const requestNext = (socket) => socket.send("next");
  const pictures = openLine("/pictures", location.port, requestNext, (data, socket) => {
    requestNext(socket);
    rcm.receivedAt = performance.now();
    const length = new DataView(data).getUint32(0, true);
    rcm.board = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    rcm.holds = rcm.name !== "" && rcm.board.holder === rcm.name;
    rcm.requested = Boolean(rcm.board.requester);
    const jpeg = data.slice(4 + length);
    updateDelay();
    sendPending();
    for (const f of boardListeners) f(rcm.board, jpeg);
    if (rcm.receivedAt - refreshedAt > MIN_REFRESH_MS) refresh();
  });
  setInterval(refresh, MAX_REFRESH_MS);

  // Age of the board relative to the fastest recent transmission. A board that waited in a queue
  // while the browser was busy arrives now but describes an earlier state.
  let smallest = Infinity, smallestBefore = Infinity, windowStart = 0;
  const delay = () => performance.now() - 1e-6 * rcm.board.at;
  const age = () => delay() - Math.min(smallest, smallestBefore);
  function updateDelay() {
    if (rcm.receivedAt - windowStart > DELAY_WINDOW_MS) {
      [smallestBefore, smallest, windowStart] = [smallest, Infinity, rcm.receivedAt];
    }
    smallest = Math.min(smallest, delay());
  }

  rcm.send = (message) => operate.send(JSON.stringify({ ...message, at: rcm.board.at }));
  // A press counts only while the displayed state is fresh. A browser that was busy waits for the
  // next board, up to MAX_REQUEST_WAIT_MS.
  let pending = null;
  const sendPending = () => {
    if (pending === null) return;
    const late = performance.now() - pending.since > MAX_REQUEST_WAIT_MS;
    if (!late && !(age() < MAX_AGE_MS)) return;
    if (late) rcm.refused = "this browser was busy: press again";
    else rcm.send(pending.message);
    pending = null;
  };
  rcm.request = (action, more = {}) => {
    rcm.refused = "";
    pending = { message: { do: action, ...more }, since: performance.now() };
    sendPending();
  };
  rcm.cancelRequest = () => { pending = null; };
  rcm.connected = () => performance.now() - rcm.receivedAt < CONNECTION_TIMEOUT_MS &&
    pictures.socket !== null && operate.socket !== null;
  rcm.may = () => rcm.connected() && rcm.holds && rcm.stopLine.socket !== null;
  return rcm;
}

export const rcm = connect(window.RCMSERVO);
window.rcm = rcm;
