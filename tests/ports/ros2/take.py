"""Listens through ullage: says each piece of frames as a line of JSON. Ends when its input does. Argument: address."""

from __future__ import annotations

import json
import sys
import threading
import warnings

import ullage as ul


def main() -> None:
    warnings.showwarning = lambda text, *_: print(json.dumps({"said": str(text)}), flush=True)
    source = ul.open(sys.argv[1])
    threading.Thread(target=lambda: (sys.stdin.read(), source.stop()), daemon=True).start()
    print(json.dumps({"said": "ready"}), flush=True)
    for piece in source.stream():
        for name, frames in piece.items():
            where = None if frames.poses is None else frames.poses.position[-1].tolist()
            peak = float(frames.range_m[frames.amplitude[-1].argmax()])
            last = {"sensor": name, "n": len(frames), "t_ns": int(frames.t_ns[-1]), "at": where, "peak_m": peak}
            print(json.dumps(last), flush=True)


main()
