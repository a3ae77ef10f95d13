"""Chromium, driven through its pipe: open a page, run scripts in it, and see what it complains about and asks the network for.

``python3 tests/browser.py PAGE`` opens a report and prints what it found; exit status 1 if something is wrong with it.
"""

import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--disable-extensions",
    "--disable-background-networking", "--disable-component-update", "--remote-debugging-pipe", "about:blank",
)  # fmt: skip
#: Seconds to wait for an answer, or for a page to be ready.
PATIENCE = 120


def installed():
    """Return the program, or None."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


class Browser:
    """One page, as a context manager: ``troubles`` are its errors and warnings, ``asked`` the addresses that it asks for."""

    def __init__(self, width=1280, height=900):
        self.troubles, self.asked, self._n, self._rest, self._size = [], [], 0, b"", (width, height)

    def __enter__(self):
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        theirs_in, self._in = os.pipe()
        self._out, theirs_out = os.pipe()
        words = [installed(), *FLAGS, f"--user-data-dir={self._folder.name}", "--window-size={},{}".format(*self._size)]
        self._program = subprocess.Popen(
            ["bash", "-c", f'exec "$0" "$@" 3<&{theirs_in} 4>&{theirs_out}', *words],
            pass_fds=(theirs_in, theirs_out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(theirs_in)
        os.close(theirs_out)
        self._session = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page", "Network"):
            self.call(f"{domain}.enable")
        return self

    def __exit__(self, *exception):
        self._program.terminate()
        self._program.wait(PATIENCE)
        os.close(self._in)
        os.close(self._out)
        self._folder.cleanup()

    def call(self, method, **params):
        """Return the answer to a command of the DevTools protocol."""
        self._n += 1
        message = {"id": self._n, "method": method, "params": params} | ({"sessionId": self._session} if self._session else {})
        os.write(self._in, json.dumps(message).encode() + b"\0")
        while True:
            found = self._next()
            if found.get("id") == self._n:
                if "error" in found:
                    raise RuntimeError(f"{method}: {found['error']}")
                return found["result"]
            self._note(found)

    def _next(self):
        while b"\0" not in self._rest:
            if not select.select([self._out], [], [], PATIENCE)[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._out, 1 << 20)
            if not part:
                raise RuntimeError("the browser ended")
            self._rest += part
        first, _, self._rest = self._rest.partition(b"\0")
        return json.loads(first)

    def _note(self, event):
        method, of = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.troubles.append(of["exceptionDetails"]["exception"].get("description", "exception"))
        elif method == "Runtime.consoleAPICalled" and of["type"] in ("error", "warning", "assert"):
            self.troubles.append(" ".join(str(each.get("value", each.get("description"))) for each in of["args"]))
        elif method == "Log.entryAdded" and of["entry"]["level"] in ("error", "warning"):
            self.troubles.append(of["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.asked.append(of["request"]["url"])

    def evaluate(self, script):
        """Return the value of a script in the page."""
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"].get("description"))
        return answer["result"].get("value")

    def scheme(self, name):
        """Prefer the colour scheme ``dark`` or ``light``."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    def open(self, path):
        """Open a report and wait until all is drawn."""
        self.call("Page.navigate", url=Path(path).resolve().as_uri())
        self.wait("document.documentElement?.dataset.painted && document.documentElement.dataset.drawn === '/'")

    def wait(self, condition):
        """Wait for a condition in the page."""
        end = time.monotonic() + PATIENCE
        while not self.evaluate(condition):
            if time.monotonic() > end:
                raise TimeoutError(f"{condition} did not come; the page says {self.troubles}")
            time.sleep(0.05)

    def outside(self):
        """Return the addresses asked for that are neither files nor in the page itself."""
        return [url for url in self.asked if not url.startswith(("file:", "data:", "blob:", "about:"))]


def main():
    """Open the page of the command line."""
    if installed() is None:
        print(f"browser: none of {', '.join(PROGRAMS)} is installed; {sys.argv[1]} was not opened")
        return
    with Browser() as browser:
        browser.open(sys.argv[1])
        n = browser.evaluate("document.querySelectorAll('[data-chart] svg').length")
        if browser.troubles or browser.outside() or not n:
            raise SystemExit(f"{sys.argv[1]}: {n} charts; {browser.troubles}; asks for {browser.outside()}")
        print(f"browser: {sys.argv[1]} shows {n} charts and complains of nothing")


if __name__ == "__main__":
    main()
