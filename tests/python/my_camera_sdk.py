"""A camera's SDK, simulated, for docs/extend/own-device.md: a thread calls back with frames that it fills anew, by a clock of its own.

`CAMERA` in the environment is JSON: `hz`, `n`, `lost` (numbers that never come), `stall` (a number, and for how many s), `throws` (a number at
which the thread ends), `empty` (frames without depth), `factor` of the unit, `absent`. What was given is written to `given.json`.
"""

import json
import os
import threading
import time

import numpy as np

# Nanoseconds of the device at the epoch: it counts from when it was switched on.
BEFORE_NS = 1_700_000_000_000_000_000


class Camera:
    def __init__(self, serial, on_frame):
        self.set = {"hz": 50, "n": 20, "lost": [], "empty": [], "factor": 1.0} | json.loads(os.environ.get("CAMERA", "{}"))
        if self.set.get("absent"):
            raise ConnectionError(f"no camera {serial!r} on the bus")
        self.on_frame, self.error, self.stopped, self.given = on_frame, None, threading.Event(), []
        self.buffer = np.zeros((24, 32, 3), dtype=np.float32)
        self.thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stopped.set()
        self.thread.join()
        with open("given.json", "w", encoding="utf-8") as file:
            json.dump(self.given, file)

    def check(self):
        if self.error:
            raise self.error

    def _run(self):
        begin = time.time_ns()
        try:
            for number in range(self.set["n"]):
                at_ns = begin + int(number * 1e9 / self.set["hz"])
                if self.set.get("stall", [None])[0] == number:
                    self.stopped.wait(self.set["stall"][1])
                    begin += int(self.set["stall"][1] * 1e9)
                    at_ns += int(self.set["stall"][1] * 1e9)
                if self.stopped.wait(max(0.0, (at_ns - time.time_ns()) / 1e9)):
                    return
                if self.set.get("throws") == number:
                    raise OSError("USB transfer failed")
                if number in self.set["lost"]:
                    continue
                self._fill(number)
                measured_ns = at_ns - BEFORE_NS
                finite = self.buffer[np.isfinite(self.buffer).all(axis=-1) & (self.buffer != 0).any(axis=-1)].astype(float)
                sums = finite.sum(axis=0).tolist()
                self.given.append({"number": number, "at_ns": at_ns, "points": len(finite), "sum": sums})
                self.on_frame(number, measured_ns, self.buffer)
                self.buffer[:] = -7.0  # whoever kept the array and not a copy has this
        except Exception as error:  # handed to whoever asks
            self.error = error

    def _fill(self, number):
        """A bowl that comes nearer from frame to frame; two corners are without depth."""
        y, x = np.mgrid[0:24, 0:32]
        x, y = (x - 15.5) * 0.002, (y - 11.5) * 0.002
        self.buffer[..., 0], self.buffer[..., 1] = x, y
        self.buffer[..., 2] = 0.2 + 0.3 * (x**2 + y**2) - 0.0005 * number
        self.buffer *= np.float32(self.set["factor"])
        self.buffer[:3, :3], self.buffer[-2:, -4:] = np.nan, 0.0
        if number in self.set["empty"]:
            self.buffer[:] = np.nan
