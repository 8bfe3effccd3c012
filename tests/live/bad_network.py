"""Networks that misbehave: a relay that is late and breaks off, and namespaces whose link goes down."""

import os
import shutil
import socket
import subprocess
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import contextmanager, suppress

import numpy as np


class Relay:
    """Passes TCP on from `at` to `target`, everything `delay` [s] later; `cut` breaks every connection."""

    def __init__(self, target: str, delay: float) -> None:
        host, port = target.removeprefix("tcp/").split(":")
        self.delay, self.target = delay, (host, int(port))
        self.open = True
        self._links: list[socket.socket] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.at = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(self.target, timeout=5)
            except OSError:
                near.close()
                continue
            if not self.open:
                near.close()
                far.close()
                continue
            self._links += [near, far]
            for a, b in ((near, far), (far, near)):
                queue: deque = deque()
                threading.Thread(target=self._read, args=(a, queue), daemon=True).start()
                threading.Thread(target=self._write, args=(b, queue), daemon=True).start()

    def _read(self, source: socket.socket, queue: deque) -> None:
        data = b"begin"
        while data:
            with suppress(OSError):
                source.settimeout(None)
            try:
                data = source.recv(65536)
            except OSError:
                data = b""
            queue.append((time.monotonic() + self.delay, data))

    def _write(self, sink: socket.socket, queue: deque) -> None:
        while True:
            while not queue:
                time.sleep(0.005)
            due, data = queue.popleft()
            time.sleep(max(0.0, due - time.monotonic()))
            if not data:
                with suppress(OSError):
                    sink.shutdown(socket.SHUT_RDWR)
                return
            try:
                sink.sendall(data)
            except OSError:
                return

    def cut(self, seconds: float) -> None:
        """No connection for so long."""
        self.open = False
        links, self._links = self._links, []
        for link in links:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
            link.close()
        time.sleep(seconds)
        self.open = True

    def close(self) -> None:
        self._server.close()


class LossyRelay(Relay):
    """A relay whose links are as TCP makes of a line that loses packets: what is read waits `delay`, and with the

    chance `loss` until it was sent again, `again` later, twice that when lost once more, and so on; all after it waits
    too. `break_off` cuts all links at random moments. Draws are those of `seed`, one stream a direction of a link.
    """

    def __init__(self, target: str, delay: float, loss: float, seed: int, again: float = 0.2) -> None:
        self.loss, self.again = loss, again
        self._seeds = np.random.SeedSequence(seed)
        self.lost = self.passed = self.cuts = 0
        super().__init__(target, delay)

    def _read(self, source: socket.socket, queue: deque) -> None:
        rng = np.random.default_rng(self._seeds.spawn(1)[0])
        due, data = 0.0, b"begin"
        while data:
            try:
                data = source.recv(1460)  # a packet
            except OSError:
                data = b""
            late, wait = self.delay, self.again
            while data and rng.random() < self.loss:
                late, wait = late + wait, 2.0 * wait
                self.lost += 1
            self.passed += bool(data)
            due = max(due, time.monotonic() + late)
            queue.append((due, data))

    def break_off(self, stop: threading.Event, every: float, longest: float) -> None:
        """Until `stop`: all links go, `every` seconds apart in the mean, each time for `longest` at most."""
        rng = np.random.default_rng(self._seeds.spawn(1)[0])
        while not stop.wait(min(rng.exponential(every), 3.0 * every)):
            self.cuts += 1
            self.cut(float(rng.uniform(0.0, longest)))


def killed_at_random(fleet, start: Mapping[str, Callable], kills: int, rng: np.random.Generator) -> Counter:
    """Each of the processes begun, and killed and begun again `kills` times, in a random order at random moments.

    How often each was: one that had ended before its turn was not.
    """
    for begin in start.values():
        begin()
    killed: Counter = Counter()
    for name in rng.permutation([name for name in start for _ in range(kills)]).tolist():
        time.sleep(float(rng.uniform(0.2, 4.0)))
        if fleet.running[name].poll() is None:
            fleet.kill(name)
            start[name]()
            killed[name] += 1
    return killed


def ip(*words: str) -> bool:
    return subprocess.run(["ip", *words], capture_output=True, check=False).returncode == 0  # noqa: S603, S607


@contextmanager
def two_namespaces():
    """Names of two namespaces with a cable between 10.77.0.1 and 10.77.0.2; None where they cannot be made."""
    a, b = f"mapweave-a{os.getpid()}", f"mapweave-b{os.getpid()}"
    made = shutil.which("ip") is not None and ip("netns", "add", a)
    try:
        made = made and all(
            ip(*words.split())
            for words in (
                f"netns add {b}",
                f"-n {a} link set lo up",
                f"-n {b} link set lo up",
                f"link add cable netns {a} type veth peer name cable netns {b}",
                f"-n {a} addr add 10.77.0.1/24 dev cable",
                f"-n {b} addr add 10.77.0.2/24 dev cable",
                f"-n {a} link set cable up",
                f"-n {b} link set cable up",
            )
        )
        yield (a, b) if made else None
    finally:
        ip("netns", "del", a)
        ip("netns", "del", b)


def lossy(namespace: str) -> bool:
    """Whether the cable loses 20 % of its packets now and is late by 2 s; not every kernel can."""
    command = ["tc", "-n", namespace, "qdisc", "add", "dev", "cable", "root", "netem", "delay", "2s", "loss", "20%"]
    return shutil.which("tc") is not None and subprocess.run(command, capture_output=True, check=False).returncode == 0  # noqa: S603
