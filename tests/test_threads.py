"""Threads of the Python module: forked children compute, the number of threads can be set, Ctrl-C ends a call.

Each test runs in a process of its own, which is stopped with all its children if it hangs.
"""

import os
import signal
import subprocess
import sys
import textwrap

import pytest

import snake_rs

# A job in the background starts with SIGINT ignored, and its Python does not raise KeyboardInterrupt.
SETUP = """
import os, signal, sys, time
import numpy as np
import snake_rs

signal.signal(signal.SIGINT, signal.default_int_handler)

points = np.random.default_rng(5).normal(size=(2000, 3))
options = dict(query_resolution=16, refine_steps=2)

def detect(_=None):
    return snake_rs.detect(points, **options).points.tobytes()

def in_a_child(work):
    "Whether a forked child ends with work() true."
    child = os.fork()
    if child == 0:
        try:
            os._exit(0 if work() else 1)
        finally:
            os._exit(2)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


def run(code, seconds=60):
    """The output of a new process that runs SETUP and the code; it must end well within the time."""
    command = [sys.executable, "-c", SETUP + textwrap.dedent(code)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            output, errors = process.communicate(timeout=seconds)
        finally:
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
    assert process.returncode == 0, errors
    return output


forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")


@forks
def test_every_part_of_the_module_computes_in_a_child():
    run("""
        def everything():
            model = snake_rs.Model.builtin("compact")
            field = model.encode(points)
            field.occupancy(points), field.saliency_and_gradient(points), field.descriptors(points)
            found = field.detect(**options).points
            field.mesh(resolution=16)
            normals = snake_rs.estimate_normals(points, 0.5)
            snake_rs.fpfh(points, normals, 0.5)
            snake_rs.register(points, points, descriptor="fpfh", detector="iss")
            snake_rs.baselines.iss(points), snake_rs.baselines.harris3d(points), snake_rs.baselines.sift3d(points)
            return found.tobytes()
        expected = everything()
        assert in_a_child(lambda: everything() == expected and in_a_child(lambda: everything() == expected))
        assert everything() == expected
    """)


@forks
def test_children_forked_while_another_thread_makes_the_first_call():
    # Whatever is filled at the first use may be half filled at the fork. Each child here is new to the module.
    run("""
        import threading
        def first_call():
            thread = threading.Thread(target=detect)
            thread.start()
            done = in_a_child(lambda: len(detect()) >= 0)
            thread.join()
            return done
        assert all(in_a_child(first_call) for _ in range(40))
    """)


def test_the_number_of_threads_changes_no_bit_and_is_kept_in_a_child():
    run("""
        found = []
        for number in (1, 3):
            snake_rs.set_num_threads(number)
            assert snake_rs.get_num_threads() == number
            found.append(detect())
        assert found[0] == found[1]
        if hasattr(os, "fork"):
            assert in_a_child(lambda: snake_rs.get_num_threads() == 3)
            assert in_a_child(lambda: snake_rs.set_num_threads(2) or snake_rs.get_num_threads() == 2)
        assert snake_rs.get_num_threads() == 3
    """)


@pytest.mark.parametrize("number", [-1, 0, 100_000])
def test_numbers_of_threads_that_make_no_sense_are_refused(number):
    with pytest.raises(ValueError, match=f"num_threads: {number}: allowed is 1 to "):
        snake_rs.set_num_threads(number)


# Ctrl-C

INTERRUPTED = """
import threading

many = np.random.default_rng(6).normal(size=(20_000, 3))
many /= np.linalg.norm(many, axis=1, keepdims=True)
model = snake_rs.Model.builtin()
field = model.encode(many)

def seconds_until_interrupted(call):
    "Seconds from a SIGINT in the middle of a long call to its KeyboardInterrupt."
    sent = []
    def send():
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)
    timer = threading.Timer(0.3, send)
    timer.start()
    try:
        call()
    except KeyboardInterrupt:
        return time.perf_counter() - sent[0]
    finally:
        timer.join()
    raise SystemExit("the call ended before the signal")
"""

CALLS = {
    "detect": "snake_rs.detect(many, rotations=64)",
    "encode": "model.encode(many, rotations=64)",
    "detect of a field": "field.detect(query_resolution=128, refine_steps=100, occupancy_threshold=0.01)",
    "mesh": "field.mesh(resolution=512)",
    "iss": "snake_rs.baselines.iss(many, salient_radius=1.0)",
    "fpfh": "snake_rs.fpfh(many, np.ones_like(many), 0.5)",
    "normals": "snake_rs.estimate_normals(many, 1.0)",
    "gradients": "field.occupancy_and_gradient(np.tile(many, (400, 1)))",
    "descriptors": "field.descriptors(np.tile(many, (400, 1)))",
    "saliency": "field.saliency(np.tile(many, (400, 1)))",
    "register": "snake_rs.register(many, many + 1, voxel_size=1e-4, max_keypoints=10**6)",
}


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to one process")
@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS.keys())
def test_ctrl_c_ends_a_call_within_a_fifth_of_a_second(call):
    # One of three: on a busy machine a process may have to wait for a processor.
    code = f"print(any(seconds_until_interrupted(lambda: {call}) < 0.2 for _ in range(3)))"
    assert run(textwrap.dedent(INTERRUPTED) + code).strip() == "True"
