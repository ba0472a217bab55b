"""CasADi functions over the rows of arrays: each operation is done for many rows at once.

CasADi's own interpreter takes a row at a time, about 5 ns an operation; NumPy takes a tenth of that. What depends on
shared arguments alone is computed once. Results are the same to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from operator import itemgetter
from threading import Lock, local
from typing import Any

import casadi as ca
import numpy as np
import scipy
from scipy.special import erf, erfinv

from dynamics.arrays import Floats

BLOCK = 4096  # rows that are evaluated at once: of fewer the calls of NumPy take longer than its work
CHAINED_BLOCK = 64  # rows that follow each other in one call of CasADi's interpreter

Operation = Callable[..., Any]
_Places = Callable[[list[Floats]], tuple[Floats, ...]]  # of an operation's inputs and result among the slots
_Step = tuple[Operation, _Places]


def _if_else_zero(condition: Floats, value: Floats, out: Floats) -> None:
    out[...] = np.where(condition, value, 0.0)


def _remainder(x: Floats, y: Floats, out: Floats) -> None:
    out[...] = x - y * np.rint(x / y)


UNARY: dict[int, Operation] = {
    ca.OP_ASSIGN: np.positive,
    ca.OP_LIFT: np.positive,
    ca.OP_NEG: np.negative,
    ca.OP_INV: np.reciprocal,
    ca.OP_SQ: np.square,
    ca.OP_SQRT: np.sqrt,
    ca.OP_EXP: np.exp,
    ca.OP_EXPM1: np.expm1,
    ca.OP_LOG: np.log,
    ca.OP_LOG1P: np.log1p,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_ASINH: np.arcsinh,
    ca.OP_ACOSH: np.arccosh,
    ca.OP_ATANH: np.arctanh,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FABS: np.fabs,
    ca.OP_SIGN: np.sign,
    ca.OP_NOT: np.logical_not,
    ca.OP_ERF: erf,
    ca.OP_ERFINV: erfinv,
}
BINARY: dict[int, Operation] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_FMOD: np.fmod,
    ca.OP_REMAINDER: _remainder,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
}


class _Program:
    """The operations of a function: those on shared arguments alone, then those on rows.

    Slots hold the arguments' entries, the results' entries, the function's work vector, then what all rows share.

    once, by_row: operations on slots, the result's slot last.
    fixed: slots of constants, and these.
    shared: places and slots of results that are the same for all rows.
    """

    def __init__(self, function: ca.Function, shared: Sequence[int]) -> None:
        self.starts = np.cumsum([0, *(function.numel_in(i) for i in range(function.n_in()))]).tolist()
        self.entries, self.width = self.starts[-1], function.numel_out(0)
        self.rows = self.entries + self.width + function.sz_w()
        self.once: list[_Step] = []
        self.by_row: list[_Step] = []
        self.fixed: list[tuple[int, float]] = []
        self.shared: list[tuple[int, int]] = []
        single = {slot for i in shared for slot in range(self.starts[i], self.starts[i + 1])}
        self._of_rows = [slot not in single for slot in range(self.rows)]
        self._where: dict[int, int] = {}
        for k in range(function.n_instructions()):
            self._add(function, k)

    @property
    def slots(self) -> int:
        """Number of slots."""
        return len(self._of_rows)

    def _add(self, function: ca.Function, k: int) -> None:
        code, taken, result = (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )
        if code == ca.OP_INPUT:
            self._where[result[0]] = self.starts[taken[0]] + taken[1]
        elif code == ca.OP_CONST:
            self._where[result[0]] = self._shared_slot()
            self.fixed.append((self._where[result[0]], float(function.instruction_constant(k))))
        elif code == ca.OP_OUTPUT:
            self._output(taken[0], result[1])
        else:
            self._operate(code, [self._where[place] for place in taken], result[0])

    def _operate(self, code: int, inputs: list[int], place: int) -> None:
        operation, inputs = _operation(code, inputs)
        on_rows = any(self._of_rows[slot] for slot in inputs)
        slot = self.entries + self.width + place if on_rows else self._shared_slot()
        (self.by_row if on_rows else self.once).append((operation, itemgetter(*inputs, slot)))
        self._where[place] = slot

    def _output(self, place: int, entry: int) -> None:
        slot = self._where[place]
        if self._of_rows[slot]:
            self.by_row.append((np.positive, itemgetter(slot, self.entries + entry)))
        else:
            self.shared.append((entry, slot))

    def _shared_slot(self) -> int:
        self._of_rows.append(False)
        return len(self._of_rows) - 1


def _operation(code: int, inputs: list[int]) -> tuple[Operation, list[int]]:
    """The operation of a code of CasADi's that has a counterpart, and which of its inputs it takes."""
    if code == ca.OP_TWICE:
        return np.add, inputs * 2
    if code in UNARY:
        return UNARY[code], inputs[:1]
    return BINARY[code], inputs


def _has_counterparts(function: ca.Function) -> bool:
    """Whether NumPy has all operations of a function; it has none for a call of another one."""
    codes = {function.instruction_id(k) for k in range(function.n_instructions())}
    return codes <= {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_TWICE, *UNARY, *BINARY}


class RowFunction:
    """The first output of a function, evaluated at every row. shared: places of arguments that all rows share.

    A function with an operation that NumPy does not have is evaluated by CasADi's map.
    """

    def __init__(self, function: ca.Function, *, shared: tuple[int, ...] = ()) -> None:
        self._function, self._shared = function, shared
        self._rows = [place for place in range(function.n_in()) if place not in shared]
        self._common: tuple[list[Floats], list[Floats]] = ([], [])
        self._has_program = _has_counterparts(function)

    @cached_property
    def _program(self) -> _Program:
        return _Program(self._function, self._shared)

    def __call__(self, *arguments: Floats) -> Floats:
        """(n, k) of the first output, column by column in memory. arguments: (n, width), (width,) for shared ones."""
        if not self._has_program:
            return self._mapped(arguments)
        program, columns = self._program, {place: _by_column(arguments[place]) for place in self._rows}
        count, work = len(arguments[self._rows[0]]), _work(program.rows - program.entries - program.width)
        result = np.empty((program.width, count))
        with np.errstate(all="ignore"):
            slots = self._computed_once([np.asarray(arguments[place], dtype=float) for place in self._shared])
            for entry, slot in program.shared:
                result[entry] = slots[slot]
            for start in range(0, count, BLOCK):
                block = slice(start, start + BLOCK)
                for place, values in columns.items():
                    slots[program.starts[place] : program.starts[place + 1]] = values[:, block]
                slots[program.entries : program.rows] = [*result[:, block], *work[:, : count - start]]
                _run(program.by_row, slots)
        return result.T

    def _mapped(self, arguments: Sequence[Floats]) -> Floats:
        """Values by CasADi's own map over the rows, the shared arguments repeated."""
        everything = [np.asarray(values, dtype=float).T for values in arguments]
        return np.asarray(self._function.call(everything)[0], dtype=float).T

    def _computed_once(self, shared: list[Floats]) -> list[Floats]:
        """The slots with what all rows share, (1,) each; kept while the shared arguments are the same."""
        before, slots = self._common
        if slots and all(np.array_equal(a, b) for a, b in zip(before, shared, strict=True)):
            return slots.copy()
        program = self._program
        slots = list(np.zeros((program.slots, 1)))
        for place, values in zip(self._shared, shared, strict=True):
            slots[program.starts[place] : program.starts[place + 1]] = values.reshape(-1, 1)
        for slot, value in program.fixed:
            slots[slot][0] = value
        _run(program.once, slots)
        self._common = ([values.copy() for values in shared], slots)
        return slots.copy()


def _by_column(values: Floats) -> Floats:
    """(k, n) values (n, k), each column contiguous."""
    columns = values.T
    return columns if columns.strides[-1] == values.itemsize else np.ascontiguousarray(columns)


_local = local()


def _work(count: int) -> Floats:
    """(at least count, BLOCK) a thread's memory for intermediate results."""
    if getattr(_local, "work", np.empty((0, 0))).shape[0] < count:
        _local.work = np.empty((count, BLOCK))
    return np.asarray(_local.work[:count])


def _run(steps: Sequence[_Step], slots: list[Floats]) -> None:
    for operation, places in steps:
        operation(*places(slots))


class Recurrence:
    """A function from one row's state to the next row's, applied row after row.

    What its first output adds to states that it multiplies by factors is computed for all rows at once. Of other
    functions CasADi's interpreter evaluates what depends on more than the shared arguments.

    function: of the state (h,), rows' arguments and shared ones. shared: places of the latter.
    """

    def __init__(self, function: ca.Function, *, shared: tuple[int, ...]) -> None:
        arguments = [ca.SX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())]
        state, following = arguments[0], ca.cse(function(*arguments))
        slopes = ca.jacobian(following, state)
        self._linear: RowFunction | None = None
        if slopes.sparsity().is_diag() and not ca.depends_on(slopes, state):
            offset = ca.substitute(following, state, ca.SX.zeros(state.shape))
            parts = ca.Function("parts", arguments[1:], [ca.vertcat(ca.diag(slopes), offset)])
            self._linear = RowFunction(parts, shared=tuple(place - 1 for place in shared))
        else:
            self._chained = _Chained(arguments, following, shared)

    def __call__(self, initial: Floats, *arguments: Floats) -> Floats:
        """(n, h) states that follow (h,) the initial one. arguments: (n, width) each, (width,) for shared ones."""
        if self._linear is None:
            return self._chained(initial, *arguments)
        parts = self._linear(*arguments)
        return _accumulated(initial, parts[:, : len(initial)], parts[:, len(initial) :])


def _accumulated(initial: Floats, factors: Floats, offsets: Floats) -> Floats:
    """(n, h) x_1 to x_n, where x_k+1 = factors_k x_k + offsets_k; all (n, h) but initial, (h,)."""
    if np.all(factors == factors[:1]):
        columns = zip(initial, factors[0], offsets.T, strict=True)
        return np.stack([scipy.signal.lfilter([1.0], [1.0, -a], b, zi=[a * x])[0] for x, a, b in columns], axis=1)
    states, now = np.empty(offsets.shape), initial
    for k, (factor, offset) in enumerate(zip(factors, offsets, strict=True)):
        now = factor * now + offset
        states[k] = now
    return states


class _Chained:
    """The expression of a following state, by CasADi's interpreter in blocks of rows."""

    def __init__(self, arguments: Sequence[ca.SX], following: ca.SX, shared: Sequence[int]) -> None:
        common = ca.vertcat(*(arguments[place] for place in shared))
        rest, symbols, once = ca.extract_parametric(following, common)
        self._once = ca.Function("once", [common], [ca.vertcat(common, *once)])
        self._rows = [place - 1 for place in range(1, len(arguments)) if place not in shared]
        self._shared = [place - 1 for place in shared]
        rows = [arguments[place + 1] for place in self._rows]
        step = ca.Function("step", [arguments[0], *rows, ca.vertcat(common, *symbols)], [rest])
        buffer: Any
        buffer, self._evaluate = step.mapaccum("rows", CHAINED_BLOCK).buffer()
        self._buffer = buffer
        self._lock = Lock()

    def __call__(self, initial: Floats, *arguments: Floats) -> Floats:
        common = np.array(self._once(np.concatenate([arguments[place] for place in self._shared]))).ravel()
        repeated = np.tile(common, (CHAINED_BLOCK, 1))
        rows = [np.ascontiguousarray(arguments[place], dtype=float) for place in self._rows]
        count, state = len(rows[0]), np.array(initial, dtype=float)
        result = np.empty((-(-count // CHAINED_BLOCK) * CHAINED_BLOCK, len(state)))
        for start in range(0, count, CHAINED_BLOCK):
            stop = start + CHAINED_BLOCK
            parts = [values[start:stop] if stop <= count else _filled_up(values[start:]) for values in rows]
            with self._lock:
                self._buffer.set_res(0, result[start:stop].reshape(-1).data)
                for place, values in enumerate((state, *parts, repeated)):
                    self._buffer.set_arg(place, values.reshape(-1).data)
                self._evaluate()
            state = result[stop - 1].copy()
        return result[:count]


def _filled_up(values: Floats) -> Floats:
    return np.concatenate([values, np.repeat(values[-1:], CHAINED_BLOCK - len(values), axis=0)])
