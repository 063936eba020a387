// The page in the browser: it draws what it is sent, and says what the person wants.
"use strict";

(() => {
  const BEAT = 100, HOLD = 40, AGAIN = 500; // ms
  const told = window.RCMSERVO;
  const $ = (id) => document.getElementById(id);
  const rcm = (window.rcm = { drawn: 0, board: {}, name: "", holds: false, asked: false });
  let held = null, refused = "", stopWords = "", listened = 0;
  let press = Date.now(); // another page's presses are others

  const url = (path, port) =>
    `ws://${location.hostname}:${port}${path}?secret=${encodeURIComponent(told.secret)}`;

  // A websocket that is opened again whenever it is gone.
  function line(path, port, opened, heard) {
    const it = { wire: null };
    const open = () => {
      const wire = new WebSocket(url(path, port));
      wire.binaryType = "arraybuffer";
      wire.onopen = () => { it.wire = wire; opened(wire); };
      wire.onmessage = (event) => heard(event.data, wire);
      wire.onclose = () => { it.wire = null; show(); setTimeout(open, AGAIN); };
    };
    it.say = (words) => {
      const open = it.wire !== null && it.wire.readyState === WebSocket.OPEN;
      if (open) it.wire.send(words);
      return open;
    };
    open();
    return it;
  }

  const stop = line("/stop", told.stopPort, show, (words) => {
    stopWords = words === "heard" ? "" : UNHEARD;
    show();
  });
  const operate = line("/operate", location.port, show, (words) => {
    const answer = JSON.parse(words);
    if (answer.name) rcm.name = answer.name;
    if (answer.refused) refused = answer.refused;
    show();
  });
  const pictures = line("/pictures", location.port, (wire) => wire.send("next"), (data, wire) => {
    wire.send("next");
    listened = performance.now();
    const length = new DataView(data).getUint32(0, true);
    rcm.board = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    rcm.holds = rcm.name !== "" && rcm.board.holder === rcm.name;
    rcm.asked = Boolean(rcm.board.asking);
    show();
    const jpeg = data.slice(4 + length);
    if (jpeg.byteLength > 0) draw(jpeg, rcm.board);
  });

  function say(message) {
    return operate.say(JSON.stringify({ ...message, at: rcm.board.at }));
  }

  rcm.want = (what) => {
    refused = "";
    say(what === "teach" ? { do: "teach", name: $("name").value.trim() } : { do: what });
  };
  rcm.go = (name) => { refused = ""; say({ do: "go", name }); };
  const UNHEARD = "STOP was not heard: use the emergency stop of the arm";
  rcm.stop = () => {
    letGo();
    stopWords = "STOP …";
    if (!stop.say("stop")) stopWords = UNHEARD;
    say({ do: "pause" }); // beside it, should that be what is left
    setTimeout(() => { if (stopWords) stopWords = UNHEARD; show(); }, 400);
    show();
  };

  // Jog: a button counts as held only while it is, in a window that is looked at.
  function letGo() {
    if (held === null) return;
    held.button.classList.remove("held");
    held = null;
    say({ do: "release" });
  }
  function hold(button, pointer) {
    letGo();
    const rates = [0, 0, 0];
    rates[Number(button.dataset.joint)] = Number(button.dataset.sign) * 1e6; // as fast as allowed
    held = { button, rates, pointer, press: ++press, since: performance.now() };
    button.classList.add("held");
    jog();
  }
  function jog() {
    if (held !== null) say({ do: "jog", rates: held.rates, press: held.press });
  }
  setInterval(jog, HOLD);
  setInterval(() => { if (rcm.holds && held === null) say({ do: "beat" }); }, BEAT);
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", letGo);
  for (const name of ["pointerup", "pointercancel", "contextmenu"]) {
    window.addEventListener(name, letGo, true);
  }
  window.addEventListener("pointermove", (event) => {
    if (held === null || held.pointer !== event.pointerId) return;
    const box = held.button.getBoundingClientRect();
    const on = event.clientX >= box.left && event.clientX <= box.right &&
      event.clientY >= box.top && event.clientY <= box.bottom;
    if (!on || !(event.buttons & 1)) letGo();
  }, true);

  // The space bar is STOP, and never presses the button that has the focus.
  const typing = (event) => event.target instanceof HTMLInputElement;
  window.addEventListener("keydown", (event) => {
    if (event.code !== "Space" || typing(event)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) rcm.stop();
  }, true);
  window.addEventListener("keyup", (event) => {
    if (event.code === "Space" && !typing(event)) event.preventDefault();
  }, true);

  // What is shown beside the picture.
  const UNHEARD_NOW = "STOP is not connected: use the emergency stop of the arm";
  const MOVES = ["ACQUIRE", "SERVO", "HOLD"];
  function errors(board) {
    if (!known(board.delta)) return "exploring";
    const [s, r, d] = board.delta;
    const degrees = (s * 180 / Math.PI).toFixed(2);
    return `Δs ${degrees}°  Δr ${r.toFixed(1)} px  Δd ${d.toFixed(1)} px`;
  }
  const WAITING = ["OFF", "FAULT"], JOGS = ["IDLE", "PAUSED", "JOG"];
  function show() {
    if (!$("state")) return;
    const board = rcm.board, hears = performance.now() - listened < 1000;
    const connected = hears && pictures.wire !== null && operate.wire !== null;
    const state = $("state");
    state.dataset.phase = board.phase || "";
    state.dataset.action = board.action || "";
    state.classList.toggle("lost", !connected);
    $("phase").textContent = connected ? board.words || "" : "no connection to the server";
    $("why").textContent = connected ? board.why || "" : "";
    $("way").textContent = connected && board.way_out ? `→ ${board.way_out}` : "";
    $("errors").textContent = connected && MOVES.includes(board.phase) ? errors(board) : "";
    $("control").textContent = rcm.holds
      ? rcm.asked ? "you have control; another browser asks for it" : "you have control"
      : "you watch";
    $("notes").textContent = [...(board.notes || []), refused].filter(Boolean).join("\n");
    $("unheard").textContent = stopWords || (stop.wire === null ? UNHEARD_NOW : "");
    $("stop").classList.toggle("deaf", stop.wire === null);
    const may = connected && rcm.holds && stop.wire !== null, moving = !WAITING.includes(board.phase);
    enable("enable", may && board.ready);
    enable("pause", may && moving && board.phase !== "PAUSED");
    enable("resume", may && board.phase === "PAUSED");
    enable("clear", may && board.clears);
    enable("teach", may && moving);
    enable("ask", connected && !rcm.holds);
    enable("give", may && rcm.asked);
    for (const button of document.querySelectorAll(".jog")) {
      button.disabled = !(may && JOGS.includes(board.phase));
    }
    const over = held !== null && performance.now() - held.since > 500 && board.phase !== "JOG";
    if (over || (held !== null && held.button.disabled)) letGo();
    poses(board.poses || [], may && moving);
  }
  function enable(what, can) {
    const button = document.querySelector(`[data-do="${what}"]`);
    if (!button) return;
    button.disabled = !can;
    button.classList.toggle("disabled", !can);
    button.setAttribute("aria-disabled", String(!can));
  }
  let listed = null;
  function poses(names, can) {
    const key = JSON.stringify(names);
    if (key !== listed) {
      listed = key;
      $("poses").replaceChildren(...names.map((name) => {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = `Go to ${name}`;
        button.setAttribute("aria-label", `Go ${name}`);
        button.onclick = () => rcm.go(name);
        return button;
      }));
    }
    for (const button of $("poses").children) button.disabled = !can;
  }

  // The picture, with the tool blue and the target black, as in the paper's figures.
  const BLUE = "#005aff", BLACK = "#000000", WHITE = "#ffffff", YELLOW = "#ffdc00";
  async function draw(jpeg, board) {
    const image = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
    const canvas = $("picture");
    if (!canvas) return;
    if (canvas.width !== image.width || canvas.height !== image.height) {
      canvas.width = image.width;
      canvas.height = image.height;
    }
    const pen = canvas.getContext("2d");
    pen.drawImage(image, 0, 0);
    image.close();
    const size = canvas.width / 640;
    if (board.target) tool(pen, board.target, board.rcm, BLACK, size, ["", ""]);
    if (board.points) tool(pen, board.points, board.rcm, BLUE, size, ["m₁", "m₂"]);
    rcmMark(pen, board.rcm, canvas, size);
    rcm.drawn += 1;
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

  document.addEventListener("pointerdown", (event) => {
    const at = event.target instanceof Element ? event.target : null;
    if (at && at.closest("#stop")) rcm.stop();
    const button = at && at.closest(".jog");
    const pressed = event.button === 0 && event.isPrimary && !event.ctrlKey && held === null;
    if (button && !button.disabled && pressed) {
      event.preventDefault();
      button.focus();
      hold(button, event.pointerId);
    }
  });
  document.addEventListener("click", (event) => {
    // of a keyboard or a screen reader: no pointer went down
    const at = event.target instanceof Element ? event.target.closest("#stop") : null;
    if (at && event.detail === 0) rcm.stop();
  });
  document.addEventListener("keydown", (event) => {
    const button = event.target instanceof Element ? event.target.closest(".jog") : null;
    if (event.code === "Enter" && button && !button.disabled && !event.repeat && held === null) {
      event.preventDefault();
      hold(button, null);
    }
  });
  document.addEventListener("keyup", (event) => { if (event.code === "Enter") letGo(); });
  setInterval(show, 250);
})();
