"""A copy of a process begins as a new one would, and ends with the status of its program."""

import json
import subprocess
import sys
import textwrap

import pytest

PARENT = """
import json, os, signal, subprocess, sys, threading
from firmware_model.process.fork import can_fork, run_in_copy

def program(words):
    print(json.dumps({
        "words": words, "files": sorted(os.listdir("/proc/self/fd"))[:-1], "line": sys.stdin.readline(),
        "handlers": [signal.getsignal(each) is signal.SIG_DFL for each in (signal.SIGTERM, signal.SIGHUP)],
        "path": [each for each in sys.path if each in ("", os.getcwd())], "kept": kept,
        "name": open("/proc/self/comm").read().strip(), "session": os.getsid(0) == os.getpid(),
    }))
    return END

kept, held = "what the parent has", open(os.devnull)
sys.path.insert(0, "")
for each in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(each, lambda *_: None)
print("said before", end="")  # in the parent's buffer: the child must not say it too
child = subprocess.Popen(
    ["never"], preexec_fn=run_in_copy("the-child", program, ["--a"]), text=True, start_new_session=True,
    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
)
out, error = child.communicate("hello\\n")
threading.Thread(target=threading.Event().wait, daemon=True).start()
print(json.dumps([child.returncode, out, error, can_fork()]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing is copied")
@pytest.mark.parametrize(("end", "status"), [("5", 5), ("1 / 0", 1)])
def test_a_copy_begins_anew_and_ends_with_the_status_of_its_program(end, status):
    parent = textwrap.dedent(PARENT).replace("END", end)
    said = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, check=True, timeout=60).stdout
    code, out, error, forks_beside_threads = json.loads(said.removeprefix("said before"))
    assert (code, forks_beside_threads) == (status, False)
    found = {} if end != "5" else json.loads(out)
    if found:
        assert found == {
            "words": ["--a"], "files": ["0", "1", "2"], "line": "hello\n", "handlers": [True, True], "path": [],
            "kept": "what the parent has", "name": "the-child", "session": True,
        }  # fmt: skip
    assert ("ZeroDivisionError" in error) == (status == 1)
