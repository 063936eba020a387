// Connection to the server: websockets for pictures, requests and STOP.
//
// view             reactive state that the widgets display
// can(action)      true if the user may request an action now
// rcm.board        newest content of the page, as page/view_model.py describes it
// rcm.onBoard(f)   call f(board, jpeg) with each new content
// rcm.onChange(f)  call f() whenever the displayed state may have changed
// rcm.send(m)      send a message now; the server refuses it if rcm.board is old
// rcm.request(action, more)  send a request with its arguments as soon as rcm.board is fresh
// rcm.cancelRequest()        discard a request that waits
// rcm.url(path)    address of the server's data
import { shallowReactive } from "vue";

const RECONNECT_MS = 500, CONNECTION_TIMEOUT_MS = 1000;
const MIN_REFRESH_MS = 80, MAX_REFRESH_MS = 250; // time between two updates of `view`
const MAX_BOARD_AGE_MS = 200, MAX_REQUEST_WAIT_MS = 500, DELAY_WINDOW_MS = 10000;
export const STOP_FAILED = "STOP did not arrive: use the emergency stop of the arm";

export const view = shallowReactive({
  board: {}, isConnected: false, mayOperate: false, hasControl: false, isControlRequested: false,
  refusal: "", stopStatus: "", isStopConnected: false,
});

export const can = (action) => {
  if (action === "request_control") return view.isConnected && !view.hasControl;
  if (action === "hand_over") return view.mayOperate && view.isControlRequested;
  return view.mayOperate && (view.board.can || []).includes(action);
};

function connect(site) {
  const boardListeners = [], changeListeners = [];
  const rcm = { drawn: 0, board: {}, name: "", hasControl: false, isControlRequested: false,
    refusal: "", receivedAt: 0, stopStatus: "", isJogging: () => false, releaseJog: () => {} };
  const secret = encodeURIComponent(site.secret);
  rcm.url = (path) => `${path}${path.includes("?") ? "&" : "?"}secret=${secret}`;
  rcm.onBoard = (listener) => boardListeners.push(listener);
  rcm.onChange = (listener) => changeListeners.push(listener);
  let refreshedAt = 0;
  const refresh = () => {
    refreshedAt = performance.now();
    const { board, hasControl, isControlRequested, refusal, stopStatus } = rcm;
    Object.assign(view, { board, hasControl, isControlRequested, refusal, stopStatus,
      isConnected: rcm.isConnected(), mayOperate: rcm.mayOperate(),
      isStopConnected: rcm.stopLine.socket !== null });
    for (const listener of changeListeners) listener();
  };
  rcm.refresh = refresh;

  // Open a websocket that reconnects after it was closed. Its `socket` is null while it is closed.
  function openLine(path, port, onOpen, onMessage) {
    const line = { socket: null };
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const open = () => {
      const socket = new WebSocket(`${scheme}://${location.hostname}:${port}${rcm.url(path)}`);
      socket.binaryType = "arraybuffer";
      socket.onopen = () => { line.socket = socket; onOpen(socket); };
      socket.onmessage = (event) => onMessage(event.data, socket);
      socket.onclose = () => { line.socket = null; refresh(); setTimeout(open, RECONNECT_MS); };
    };
    line.send = (text) => {
      const isReady = line.socket !== null && line.socket.readyState === WebSocket.OPEN;
      if (isReady) line.socket.send(text);
      return isReady;
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
    if (answer.refused) rcm.refusal = answer.refused;
    refresh();
  });
  const requestNext = (socket) => socket.send("next");
  // A message holds the length of the board's JSON in bytes, the JSON, and the JPEG picture.
  const pictures = openLine("/pictures", location.port, requestNext, (data, socket) => {
    requestNext(socket);
    rcm.receivedAt = performance.now();
    const length = new DataView(data).getUint32(0, true);
    rcm.board = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    rcm.hasControl = rcm.name !== "" && rcm.board.holder === rcm.name;
    rcm.isControlRequested = Boolean(rcm.board.requester);
    const jpeg = data.slice(4 + length);
    updateDelay();
    sendPending();
    for (const listener of boardListeners) listener(rcm.board, jpeg);
    if (rcm.receivedAt - refreshedAt > MIN_REFRESH_MS) refresh();
  });
  setInterval(refresh, MAX_REFRESH_MS);

  // Age of the board. A board that waited in a queue while the browser was busy arrives now but
  // describes an earlier state. Server and browser have different clocks, so that the smallest
  // delay of the present and the previous window stands for a transmission without a queue.
  let minDelay = Infinity, previousMinDelay = Infinity, windowStart = 0;
  const delay = () => performance.now() - 1e-6 * rcm.board.at;
  const boardAge = () => delay() - Math.min(minDelay, previousMinDelay);
  function updateDelay() {
    if (rcm.receivedAt - windowStart > DELAY_WINDOW_MS) {
      [previousMinDelay, minDelay, windowStart] = [minDelay, Infinity, rcm.receivedAt];
    }
    minDelay = Math.min(minDelay, delay());
  }

  rcm.send = (message) => operate.send(JSON.stringify({ ...message, at: rcm.board.at }));
  // A press counts only while the displayed state is fresh. A browser that was busy waits for the
  // next board, up to MAX_REQUEST_WAIT_MS.
  let pending = null;
  const sendPending = () => {
    if (pending === null) return;
    const isLate = performance.now() - pending.since > MAX_REQUEST_WAIT_MS;
    if (!isLate && !(boardAge() < MAX_BOARD_AGE_MS)) return;
    if (isLate) rcm.refusal = "this browser was busy: press again";
    else rcm.send(pending.message);
    pending = null;
  };
  rcm.request = (action, more = {}) => {
    rcm.refusal = "";
    pending = { message: { do: action, ...more }, since: performance.now() };
    sendPending();
  };
  rcm.cancelRequest = () => { pending = null; };
  rcm.isConnected = () => performance.now() - rcm.receivedAt < CONNECTION_TIMEOUT_MS &&
    pictures.socket !== null && operate.socket !== null;
  rcm.mayOperate = () => rcm.isConnected() && rcm.hasControl && rcm.stopLine.socket !== null;
  return rcm;
}

export const rcm = connect(window.RCMSERVO);
window.rcm = rcm;
