// The page in the browser: it draws what it is sent, and says what the person wants.
"use strict";

(() => {
  const BEAT = 100, HOLD = 40, AGAIN = 500; // ms
  const told = window.RCMSERVO;
  const $ = (id) => document.getElementById(id);
  const rcm = (window.rcm = { drawn: 0, board: {}, name: "", holds: false, asked: false });
  let held = null, press = 0, refused = "";

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
    if (words !== "heard") refused = "STOP was not heard: use the emergency stop of the arm";
  });
  const operate = line("/operate", location.port, show, (words) => {
    const answer = JSON.parse(words);
    if (answer.name) rcm.name = answer.name;
    if (answer.refused) refused = answer.refused;
    show();
  });
  const pictures = line("/pictures", location.port, (wire) => wire.send("next"), (data, wire) => {
    wire.send("next");
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
  rcm.stop = () => {
    letGo();
    if (!stop.say("stop")) refused = "STOP cannot be heard: use the emergency stop of the arm";
    show();
  };

  // Jog: a button counts as held only while it is, in a window that is looked at.
  function letGo() {
    if (held !== null) held.button.classList.remove("held");
    held = null;
  }
  function hold(button) {
    const rates = [0, 0, 0];
    rates[Number(button.dataset.joint)] = Number(button.dataset.sign) * 1e6; // as fast as allowed
    held = { button, rates, press: ++press };
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
  for (const name of ["pointerup", "pointercancel"]) window.addEventListener(name, letGo);

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
  const WAITING = ["OFF", "FAULT"], JOGS = ["IDLE", "PAUSED", "JOG"];
  function show() {
    if (!$("state")) return;
    const board = rcm.board, connected = pictures.wire !== null && operate.wire !== null;
    const state = $("state");
    state.dataset.phase = board.phase || "";
    state.dataset.action = board.action || "";
    state.classList.toggle("lost", !connected);
    $("phase").textContent = connected ? board.words || "" : "no connection to the server";
    $("why").textContent = connected ? board.why || "" : "";
    $("way").textContent = connected && board.way_out ? `→ ${board.way_out}` : "";
    $("control").textContent = rcm.holds
      ? rcm.asked ? "you have control; another browser asks for it" : "you have control"
      : "you watch";
    $("notes").textContent = [...(board.notes || []), refused].filter(Boolean).join("\n");
    $("stop").disabled = stop.wire === null;
    const may = connected && rcm.holds, moving = !WAITING.includes(board.phase);
    enable("enable", may && board.ready);
    enable("pause", may && moving && board.phase !== "PAUSED");
    enable("resume", may && board.phase === "PAUSED");
    enable("clear", may && board.phase === "FAULT");
    enable("teach", may && moving);
    enable("ask", connected && !rcm.holds);
    enable("give", may && rcm.asked);
    for (const button of document.querySelectorAll(".jog")) {
      button.disabled = !(may && JOGS.includes(board.phase));
    }
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
    if (button && !button.disabled) { event.preventDefault(); button.focus(); hold(button); }
  });
  document.addEventListener("click", (event) => {
    // of a keyboard or a screen reader: no pointer went down
    const at = event.target instanceof Element ? event.target.closest("#stop") : null;
    if (at && event.detail === 0) rcm.stop();
  });
  document.addEventListener("keydown", (event) => {
    const button = event.target instanceof Element ? event.target.closest(".jog") : null;
    if (event.code === "Enter" && button && !event.repeat && held === null) {
      event.preventDefault();
      hold(button);
    }
  });
  document.addEventListener("keyup", (event) => { if (event.code === "Enter") letGo(); });
  setInterval(show, 250);
})();
