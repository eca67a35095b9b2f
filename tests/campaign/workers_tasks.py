"""Tasks that workers import."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time


def do(context, task):
    """Return what came in, or go wrong as the task says; a folder is left behind."""
    tempfile.mkdtemp(prefix="left-")
    if task == "abort":
        print("about to abort", flush=True)
        os.abort()
    if task == "sleep":
        time.sleep(60.0)
    if task == "leave":
        os._exit(3)
    if task == "raise":
        raise ValueError("raised")
    if task == "killed":
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
    sys.stdout.write("a line\n")
    return context, task


def fail(payload, folder):
    """Prepare nothing."""
    raise RuntimeError("no such thing")
