"""A Chromium that a test looks through and types at, over the pipe of its DevTools protocol: no port, no package."""

import base64
import itertools
import json
import os
import subprocess
import time
from contextlib import contextmanager

from tests.report.browser import CHROMIUM, FLAGS

PATIENCE_S = 120


class Tab:
    """One page of a browser."""

    def __init__(self, commands, answers):
        self._commands, self._answers, self._session = commands, answers, {}
        self._numbers, self._buffer = itertools.count(1), b""
        self.console = []  # what the page has written there, and what was refused to it
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = {"sessionId": attached["sessionId"]}
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        """What the browser answers to a call of its protocol."""
        number = next(self._numbers)
        call = {"id": number, "method": method, "params": params} | self._session
        os.write(self._commands, json.dumps(call).encode() + b"\0")
        while True:
            message = self._message()
            if message.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                self.console.append(message["params"])
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]

    def _message(self):
        while b"\0" not in self._buffer:
            part = os.read(self._answers, 65536)
            assert part, "the browser has ended"
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def look(self, expression):
        """The value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, expression):
        """The value of an expression once it is true."""
        end = time.monotonic() + PATIENCE_S
        while not (value := self.look(expression)):
            assert time.monotonic() < end, (expression, self.look("document.body.innerText"))
        return value

    def show_at(self, width, height, scheme):
        """Give the page this size [px] and colour scheme."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def press(self, key, code):
        """Press a key and let it go."""
        text = {"text": "\r"} if key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **text)

    def picture(self, path):
        """Save what the page shows as a PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))


@contextmanager
def tab(folder):
    """A fresh browser with one page, its profile in this folder."""
    from_us, commands = os.pipe()
    answers, to_us = os.pipe()

    def take_their_places():  # the browser reads from 3 and writes to 4
        for descriptor, place in ((os.dup(from_us), 3), (os.dup(to_us), 4)):
            os.dup2(descriptor, place)

    browser = subprocess.Popen(
        [CHROMIUM, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--remote-debugging-pipe"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        close_fds=False,
        preexec_fn=take_their_places,
    )
    try:
        os.close(from_us)
        os.close(to_us)
        yield Tab(commands, answers)
    finally:
        browser.kill()
        browser.wait()
        os.close(commands)
        os.close(answers)
