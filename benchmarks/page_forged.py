"""Robustness of the page against forged requests and invalid messages.

    python benchmarks/page_forged.py [--forged N] [--fuzzed N]

Forged: requests of each kind, with the drive off, paused, jogging, moving to a pose, and after a
STOP. They come from another origin or none, with a wrong secret, none, or that of an earlier
server, under another host name, without a token or with a wrong one, from a watching browser, or
from the controlling browser with an old, future or missing time. None may change the state, the
control, the target, the poses or the drive, nor move a joint at rest.

Fuzzed: websocket messages while the drive is on: text, bytes, random JSON, deeply nested or too
long; from the controlling browser invalid requests with the present time; incomplete frames and
dropped connections. The loop must continue its commands, the page must answer at the end, and STOP
must work after as many messages at its own port.

The exit code is 1 if anything moved, changed or stopped.
"""

import argparse
import contextlib
import itertools
import json
import random
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from page_lab import Client, PageLab, awaited, board, machine, page_lab
from websockets.exceptions import ConnectionClosed, InvalidStatus

MOVING = "ACQUIRE", "SERVO", "HOLD"
GAP = 50.0  # ms between commands after which the arm stops by itself
EACH = 100  # messages between checks of the arm's log
WANTS: list[dict[str, Any]] = [
    {"do": "enable"},
    {"do": "jog", "rates": [0.5, 0.5, 5.0], "press": 7},
    {"do": "jog", "velocity": [0.0, 10.0, 0.0], "press": 8},
    {"do": "go", "name": "here"},
    {"do": "sequence", "waypoints": [{"pose": "here", "dwell": 0.0}], "rounds": 1000},
    {"do": "teach", "name": "forged"},
    {"do": "delete", "name": "here"},
    {"do": "teach_again"},
    {"do": "set", "part": "gains", "values": {}},
    {"do": "disturb", "disturbance": "occlusion"},
    {"do": "resume"},
    {"do": "pause"},
    {"do": "clear"},
]
"""Requests of unauthorised clients."""


class Holder:
    """Controlling browser, which sends ten heartbeats per second or holds a jog button."""

    def __init__(self, lab: PageLab) -> None:
        self.client, self.lab = Client(lab.address, lab.token), lab
        self._lines = contextlib.ExitStack()
        self.hand = self._lines.enter_context(self.client.open("/operate"))
        self.eye = self._lines.enter_context(self.client.open("/pictures"))
        self.name = json.loads(self.hand.recv(20.0))["name"]
        self.now: dict[str, Any] = board(self.eye)
        self.refused, self.jogs, self.press = 0, False, 0
        self.presses = itertools.count(int(time.time()))
        for work in (self._look, self._beat, self._hear):
            threading.Thread(target=self._goes, args=(work,), daemon=True).start()

    def _goes(self, work: Callable[[], None]) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                work()

    def _look(self) -> None:
        self.now = board(self.eye)

    def _hear(self) -> None:
        self.refused += "refused" in json.loads(self.hand.recv())

    def _beat(self) -> None:
        if self.jogs:
            self.say({"do": "jog", "rates": [0.04, 0.0, 0.0], "press": self.press})
        else:
            self.say({"do": "beat"})
        time.sleep(0.03 if self.jogs else 0.1)

    def say(self, want: dict[str, Any]) -> None:
        self.hand.send(json.dumps({"at": self.now["at"], **want}))

    def until(self, want: dict[str, Any], *phases: str) -> None:
        """Repeat a request until the phase is one of `phases`, since busy machines are slow."""
        for _ in range(60):
            self.say(want)
            with contextlib.suppress(TimeoutError):
                return awaited(lambda: self.now["phase"] in phases, 2.0)
        raise TimeoutError(f"{want} leads to {self.now['phase']}")

    def jog(self, on: bool) -> None:
        if not on:
            self.jogs = False
            self.until({"do": "release"}, "PAUSED")
        for _ in range(60 * on):
            self.press, self.jogs = next(self.presses), True
            with contextlib.suppress(TimeoutError):
                return awaited(lambda: self.now["phase"] == "JOG", 1.0)

    def enable(self) -> None:
        awaited(lambda: "enable" in self.now["can"])
        self.until({"do": "enable"}, "PAUSED")

    def stands(self) -> dict[str, Any]:
        """Return the state that no forged request may change."""
        awaited(lambda: self.now["phase"] != "OFF" or "enable" in self.now["can"])
        state, row = self.now, self.lab.bench.log.last()
        phase = "on its way" if state["phase"] in MOVING else state["phase"]
        unchanged = {name: state[name] for name in ("holder", "requester", "target", "poses")}
        still = row["q"].round(3).tolist() if phase in ("OFF", "PAUSED", "FAULT") else None
        return {"phase": phase, **unchanged, "enabled": int(row["enabled"]), "q": still}


def handshake(client: Client, path: str, host: str, text: str) -> None:
    """Open a websocket under another host name, and send a message."""
    with socket.create_connection(("127.0.0.1", client.port(path)), timeout=20.0) as wire:
        lines = [
            f"GET {path}?secret={client.page_config['secret']} HTTP/1.1",
            f"Host: {host}",
            f"Origin: http://{host}",
            f"Cookie: {client.known()}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        ]
        wire.sendall(("\r\n".join(lines) + "\r\n\r\n" + text).encode())
        answer = wire.recv(4096).split(b"\r\n")[0]
        if b" 40" not in answer:
            raise AssertionError(f"{path} under the name {host} answers {answer!r}")


def outside(holder: Holder, want: dict[str, Any], **how: str) -> None:
    """Send a request that each endpoint must reject at the handshake."""
    for path in ("/operate", "/pictures", "/stop"):
        try:
            with holder.client.open(path, **how) as wire:
                wire.send(json.dumps({"at": holder.now["at"], **want}))
        except InvalidStatus:
            continue
        raise AssertionError(f"{path} accepts {how}")


def unsigned(holder: Holder, want: dict[str, Any], cookie: str) -> None:
    """Send a request with the secret but without a valid token; STOP needs the secret only."""
    for path in ("/operate", "/pictures"):
        try:
            with holder.client.open(path, cookie=cookie) as wire:
                wire.send(json.dumps({"at": holder.now["at"], **want}))
        except InvalidStatus:
            continue
        raise AssertionError(f"{path} accepts a client without a token")


def watching(holder: Holder, want: dict[str, Any]) -> None:
    """Send a request from a browser without control."""
    with holder.client.open("/operate") as wire:
        wire.recv(20.0)
        wire.send(json.dumps({"at": holder.now["at"], **want}))
        if "refused" not in json.loads(wire.recv(20.0)):
            raise AssertionError(f"{want} of a watching browser is not rejected")


def at(holder: Holder, want: dict[str, Any], moment: object) -> None:
    """Send a request from the controlling browser with an invalid time."""
    before = holder.refused
    holder.say({**want, "at": moment})
    awaited(lambda: holder.refused > before, 20.0)


def port_of(holder: Holder) -> str:
    return holder.lab.address.rpartition(":")[2]


FORGERIES: dict[str, Callable[[Holder, dict[str, Any]], None]] = {
    "another origin": lambda h, w: outside(h, w, origin="http://evil.example"),
    "another port": lambda h, w: outside(h, w, origin="http://127.0.0.1:1"),
    "no origin": lambda h, w: outside(h, w, origin="null"),
    "no secret": lambda h, w: outside(h, w, secret=""),
    "an old session": lambda h, w: outside(h, w, secret=secrets.token_urlsafe(32)),
    "no token": lambda h, w: unsigned(h, w, ""),
    "a wrong token": lambda h, w: unsigned(h, w, secrets.token_urlsafe(32)),
    "another name": lambda h, w: handshake(
        h.client, "/operate", f"evil.example:{port_of(h)}", json.dumps(w)
    ),
    "without control": watching,
    "long gone": lambda h, w: at(h, w, h.now["at"] - 1_000_000_000),
    "to come": lambda h, w: at(h, w, h.now["at"] + 3_600_000_000_000),
    "no moment": lambda h, w: at(h, w, None),
    "no number": lambda h, w: at(h, w, True),
}


Forgery = tuple[str, dict[str, Any]]
"""Kind of a forged request, and the request."""


def list_forgeries() -> Iterator[Forgery]:
    """Yield all pairs again and again, so that any few of them have every kind and request."""
    for first in itertools.count():
        for number, kind in enumerate(FORGERIES):
            yield kind, WANTS[(first + number) % len(WANTS)]


def forge(holder: Holder, forgeries: Iterable[Forgery]) -> list[str]:
    """Send forged requests in the present state; return the failures."""
    failures: list[str] = []
    before = holder.stands()
    for kind, want in forgeries:
        try:
            FORGERIES[kind](holder, want)
        except (AssertionError, TimeoutError) as error:
            failures.append(f"{kind}: {error}")
        if (after := holder.stands()) != before:
            failures.append(f"{kind}, {want['do']}: {before} became {after}")
            before = after
    return failures


def forged(holder: Holder, count: int) -> dict[str, list[str]]:
    """Send forged requests in five states; return the failures by state, with the drive paused."""
    found: dict[str, list[str]] = {}
    forgeries, per_state = list_forgeries(), -(-count // 5)

    def some() -> Iterator[Forgery]:
        return itertools.islice(forgeries, per_state)

    holder.enable()
    holder.until({"do": "teach", "name": "here"}, "PAUSED")
    awaited(lambda: "here" in holder.now["poses"])
    found["paused"] = forge(holder, some())
    holder.jog(True)
    found["jogging"] = forge(holder, some())
    holder.jog(False)
    holder.until({"do": "go", "name": "here"}, *MOVING)
    found["on its way"] = forge(holder, some())
    with holder.client.open("/stop") as stop:
        stop.send("stop")
        awaited(lambda: "clear" in holder.now["can"] and holder.now["target"] is None)
    found["after a STOP"] = forge(holder, some())
    holder.until({"do": "clear"}, "OFF")
    awaited(lambda: "enable" in holder.now["can"])
    found["off"] = forge(holder, some())
    holder.enable()
    return found


class Ticks:
    """Commands of the loop in the arm's log: longest gap (ms), and whether the arm was at rest."""

    def __init__(self, lab: PageLab) -> None:
        self._log = lab.bench.log
        self._count = self._log.count
        self.longest, self.still = 0.0, True

    def look(self) -> None:
        rows = self._log.since(self._count)
        came = rows["wall"][np.flatnonzero(np.diff(rows["number"])) + 1] * 1e-6
        gaps = np.diff([rows["wall"][0] * 1e-6, *came, rows["wall"][-1] * 1e-6])
        self.longest = max(self.longest, float(gaps.max()))
        self.still = self.still and bool(rows["enabled"].all()) and not rows["applied"].any()
        self._count = self._log.count - 1


def invalid_message(draw: random.Random) -> str | bytes:
    """Return a random invalid message."""
    kinds: list[Callable[[], str | bytes]] = [
        lambda: draw.randbytes(draw.randrange(300)),
        lambda: "".join(chr(draw.randrange(1, 0xD7FF)) for _ in range(draw.randrange(200))),
        lambda: "[" * draw.randrange(1, 30000),
        lambda: '{"do":' * draw.randrange(1, 300),
        lambda: "x" * draw.randrange(60000),
        lambda: json.dumps(value(draw, 3)),
        lambda: json.dumps({"do": draw.choice(WANTS)["do"], "at": value(draw, 1)}),
        lambda: json.dumps({"do": value(draw, 2), "at": time.monotonic_ns()}),
    ]
    return draw.choice(kinds)()


def value(draw: random.Random, deep: int) -> Any:
    """Return a random JSON value."""
    if deep and draw.random() < 0.4:
        return {str(value(draw, 0)): value(draw, deep - 1) for _ in range(draw.randrange(4))}
    plain = None, True, "", "\ud800", "../../etc", 10**30, -(2**63), 1e308, float("nan"), 0, [[]]
    return draw.choice(plain)


def nearly_valid_request(draw: random.Random) -> dict[str, Any]:
    """Return a request of the controlling browser with one invalid value."""
    bad = draw.choice([None, [], [0.0], [1, 2, "3"], [float("nan")] * 3, {}, "x", [[1], 2, 3]])
    names = "", " x", "x" * 41, "\n", 3, None, ["x"], "no such pose"
    return draw.choice(
        [
            {"do": "jog", "rates": bad, "press": 1},
            {"do": "jog", "rates": [0.1, 0, 0], "press": draw.choice([None, 0.5, "1", 2**63])},
            {"do": "go", "name": draw.choice(names)},
            {"do": "delete", "name": draw.choice(names)},
            {"do": "set", "part": draw.choice(names), "values": bad},
            {"do": "disturb", "disturbance": bad},
            {"do": f"enable{draw.randrange(9)}"},
        ]
    )


def cut_off(client: Client, draw: random.Random) -> None:
    """Open a connection, send an invalid or incomplete frame, and close it."""
    path = draw.choice(["/operate", "/pictures"])
    wire = client.open(path)
    with contextlib.suppress(OSError):
        wire.socket.sendall(draw.randbytes(draw.randrange(1, 40)))
    wire.socket.close()


def fuzzed(holder: Holder, count: int, seed: int = 0) -> tuple[int, Ticks]:
    """Send invalid messages with the drive on, paused; return their number and the loop's ticks."""
    draw, ticks, said = random.Random(seed), Ticks(holder.lab), 0
    while said < count:
        try:
            with (
                holder.client.open("/operate") as hand,
                holder.client.open("/pictures") as eye,
            ):
                for _ in range(EACH // 2):
                    wire = draw.choice([hand, eye])
                    wire.send(invalid_message(draw))
                    if draw.random() < 0.3:
                        wire.recv(0.001)
                    holder.say(nearly_valid_request(draw))
                    said += 2
        except (ConnectionClosed, TimeoutError):
            pass  # the page closed the connection, or there is no answer yet
        cut_off(holder.client, draw)
        said += 1
        ticks.look()
    return said, ticks


def stop_heard(holder: Holder, count: int) -> bool:
    """Return whether the control is unchanged and STOP works after invalid messages at its port."""
    draw = random.Random(1)
    for _ in range(count):
        with socket.create_connection(("127.0.0.1", holder.client.port("/stop"))) as wire:
            wire.sendall(draw.choice([b"", b"GET /stop HTTP/1.1\r\n\r\n", draw.randbytes(100)]))
    if holder.now["phase"] != "PAUSED" or holder.now["holder"] != holder.name:
        return False
    with holder.client.open("/stop") as wire:
        wire.send("stop")
        heard = wire.recv(20.0) == "heard"
    awaited(
        lambda: "clear" in holder.now["can"] and not holder.lab.bench.log.last()["enabled"], 20.0
    )
    return heard


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--forged", type=int, default=1000)
    parser.add_argument("--fuzzed", type=int, default=10_000)
    chosen = parser.parse_args()
    print(machine(), flush=True)
    bad = 0
    with page_lab(recorded=True, token=secrets.token_urlsafe(32)) as lab:

        def operator() -> None:
            nonlocal bad
            holder = Holder(lab)
            for state, wrong in forged(holder, chosen.forged).items():
                print(f"forged, {state:<13} {len(wrong)} of {-(-chosen.forged // 5)} had an effect")
                for sentence in wrong[:5]:
                    print(f"  {sentence}")
                bad += len(wrong)
            said, ticks = fuzzed(holder, chosen.fuzzed)
            print(f"fuzzed: {said} messages, {holder.refused} of the controlling browser rejected")
            print(f"  longest gap without a command {ticks.longest:.1f} ms   (limit: {GAP:g} ms)")
            print(f"  arm at rest with its drive on: {ticks.still}")
            heard = stop_heard(holder, chosen.fuzzed // 20)
            print(f"  the page answers, and STOP works: {heard}")
            bad += (ticks.longest > GAP) + (not ticks.still) + (not heard)

        lab.play(operator)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
