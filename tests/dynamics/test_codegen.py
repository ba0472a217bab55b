"""Compiled code: the same numbers as interpreted, compiled once, and a message with advice when it cannot be."""

import multiprocessing
import os
import stat
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics.codegen import build_library, cache_folder, compile_functions, find_compiler, generate_c
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import EffectUse


def square_plus(constant=1.0):
    """y = x * x + constant."""
    x = ca.SX.sym("x", 3)
    return ca.Function("square_plus", [x], [x * x + constant], ["x"], ["y"])


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache of the test's own."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("ALULA_CACHE", str(folder))
    return folder


@pytest.fixture
def compilations(tmp_path, monkeypatch):
    """A compiler that notes each compilation; the call counts them."""
    notes = tmp_path / "compilations"
    notes.touch()
    wrapper = tmp_path / "counting-cc"
    wrapper.write_text(f'#!/bin/sh\ncase "$*" in *-shared*) echo $$ >>{notes};; esac\nexec {find_compiler()} "$@"\n')
    wrapper.chmod(wrapper.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("CC", str(wrapper))
    return lambda: len(notes.read_text().splitlines())


def test_compiled_and_interpreted_models_agree(arpl_250g):
    effects = [EffectUse("rotor_drag"), EffectUse("motor_lag"), EffectUse("gust"), EffectUse("ground_effect")]
    model = build_model(arpl_250g, effects=effects)
    compiled = compile_functions([model.derivative, model.observe])
    random = np.random.default_rng(0)
    for _ in range(20):
        state = random.normal(size=model.state_count)
        inputs = {
            "x": state,
            "u": random.uniform(500, 1500, 4),
            "p": model.parameter_values,
            "e": ENVIRONMENT_DEFAULT,
        }
        noise = random.normal(size=model.hidden_count)
        assert_allclose(
            compiled["derivative"](**inputs, w=noise)["xdot"],
            np.array(model.derivative(*inputs.values(), noise)).ravel(),
            rtol=1e-9,
            atol=1e-9,
        )
        observed = compiled["observe"](**inputs)
        for name, value in zip(model.observe.name_out(), model.observe(*inputs.values()), strict=True):
            assert_allclose(observed[name], np.array(value).ravel(), rtol=1e-9, atol=1e-9)


def test_matrices_are_read_and_written_by_column(cache):
    a = ca.SX.sym("a", 2, 3)
    compiled = compile_functions([ca.Function("transposed", [a], [a.T], ["a"], ["b"])])["transposed"]
    assert_allclose(compiled(a=[1, 2, 3, 4, 5, 6])["b"], [1, 3, 5, 2, 4, 6])


def test_inputs_keep_their_values_and_arrays_between_calls(cache):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    compiled = compile_functions([ca.Function("minus", [x, y], [x - y], ["x", "y"], ["z"])])["minus"]
    out = compiled.outputs["z"]
    compiled(x=5.0, y=2.0)
    assert compiled(x=7.0)["z"] is out
    assert out[0] == 5.0
    compiled.inputs["y"][0] = 3.0
    compiled.run()
    assert out[0] == 4.0


def test_the_same_code_is_compiled_once_and_other_code_again(cache, compilations):
    for _ in range(2):
        assert_allclose(compile_functions([square_plus()])["square_plus"](x=[1, 2, 3])["y"], [2, 5, 10])
    assert compilations() == 1
    assert_allclose(compile_functions([square_plus(2.0)])["square_plus"](x=[1, 2, 3])["y"], [3, 6, 11])
    assert compilations() == 2
    assert len(list(cache.glob("*.so"))) == 2


def test_other_flags_are_other_code(cache, compilations):
    sources = {"square.c": generate_c([square_plus()])}
    fast, exact = (build_library(sources, entry="square.c", flags=["-shared", "-fPIC", o]) for o in ("-O1", "-O2"))
    assert fast != exact
    assert compilations() == 2


def _compile_together(barrier, answers):
    """What each of several processes does at the same moment."""
    barrier.wait()
    compiled = compile_functions([square_plus()])["square_plus"]
    answers.put(compiled(x=[1.0, 2.0, 3.0])["y"].tolist())


def test_processes_that_compile_at_the_same_time_share_one_compilation(cache, compilations):
    context = multiprocessing.get_context("spawn")
    barrier, answers = context.Barrier(3), context.Queue()
    processes = [context.Process(target=_compile_together, args=(barrier, answers)) for _ in range(3)]
    for process in processes:
        process.start()
    assert [answers.get(timeout=250) for _ in processes] == [[2.0, 5.0, 10.0]] * 3
    for process in processes:
        process.join(timeout=250)
        assert process.exitcode == 0
    assert compilations() == 1


def test_without_a_compiler_the_message_names_one_to_install(cache, tmp_path, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RequestError, match=r"no C compiler was found.*Install one"):
        compile_functions([square_plus()])


def test_code_that_the_compiler_refuses_leaves_nothing_behind(cache):
    with pytest.raises(RequestError, match=r"refused broken\.c.*error"):
        build_library({"broken.c": "this is not C"}, entry="broken.c")
    assert [path.suffix for path in cache.iterdir()] == [".lock"]


def test_a_cache_that_cannot_be_written_is_named_with_the_way_out(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("ALULA_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(RequestError, match=r"cannot write compiled code to .*Set ALULA_CACHE to another folder"):
        compile_functions([square_plus()])


def test_sparse_outputs_are_refused_because_they_would_be_read_as_dense(cache):
    x = ca.SX.sym("x", 2)
    with pytest.raises(ValueError, match=r"diagonal has a sparse input or output; make it dense"):
        compile_functions([ca.Function("diagonal", [x], [ca.diag(x)], ["x"], ["d"])])


def test_the_cache_lies_in_the_environments_folder(monkeypatch):
    monkeypatch.setenv("ALULA_CACHE", "/a")
    assert cache_folder() == Path("/a")
    monkeypatch.delenv("ALULA_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/b")
    assert cache_folder() == Path("/b/alula")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path(os.path.expanduser("~/.cache/alula"))
