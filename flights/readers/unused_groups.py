"""Groups of numbers that no convention names, and the quantity they may be by their names and by content."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from flights.assembly import MAX_VALUE, Assembly
from flights.movement import moving_columns

MAX_NUMBERS = 64  # of one message: more is a map, an image, or a trajectory
MAX_WIDTH = 16  # rotors of a vehicle
_MIN_ROTORS = 2
_NUMBER = re.compile(r"\d+(?!.*\d)")  # the last one of a name
_AXES = re.compile(r"(?:(?<![A-Za-z])|(?<=[a-z0-9])(?=[A-Z])|_|(?<=[a-z]))([wxyzWXYZ])(?:Raw)?$")
_EULER = re.compile(r"roll|pitch|yaw", re.IGNORECASE)
_PLACES = re.compile(r"(front|rear|back|left|right|\b[fbr][lr]\b)", re.IGNORECASE)
_ROTOR = re.compile(
    r"rpm|rotor|motor|(?<![a-z])esc|pwm|throttle|servo|actuator|dshot|propeller|thruster", re.IGNORECASE
)
_SPEED = re.compile(r"rpm|omega|speed|vel", re.IGNORECASE)
_OF_MOTORS = re.compile(
    r"temp|volt|curr|batt|power(?!_?dist)|effort|torque|stamp|time|rssi|address|config|param", re.IGNORECASE
)
_OTHER = re.compile(
    _OF_MOTORS.pattern + r"|status|error|count|covariance|seq|flag|mag|baro|pressure|latitude|longitude|gps|navsat|"
    r"gain|joy|stick|manual|(?<![a-z])rc(?![a-z])|rc_?in|rcin|radio|moment|wrench|bias|variance|intensit|image|"
    r"camera|pid|integral",
    re.IGNORECASE,
)
_SETPOINT = re.compile(
    r"setpoint|command|cmd|target|desired|reference|goal|(?<![a-z])ref(?![a-z])|ctrltarget", re.IGNORECASE
)
_VECTORS = (
    ("specific_force", re.compile(r"acc|specific_force|(?<=[._])a$", re.IGNORECASE)),
    ("rate", re.compile(r"gyro|angular|omega|rate", re.IGNORECASE)),
    ("velocity", re.compile(r"vel|twist|linear|speed|(?<=[._])v$", re.IGNORECASE)),
    ("position", re.compile(r"pos|translation|point|location|lighthouse|locsrv", re.IGNORECASE)),
    ("attitude", re.compile(r"euler|rpy|attitude", re.IGNORECASE)),
)
_PULSES, _FRACTION = (800.0, 2_300.0), (0.0, 1.05)
_UNIT_LENGTH, _UNIT_SHARE = 0.02, 0.9
_GRAVITY = (8.0, 12.0)
_ALIKE = 10.0  # ratio of the columns' medians within which they may be rotors of one vehicle
_IN_WORDS = {"specific_force": "an acceleration", "rate": "body rates", "attitude": "an attitude"}


@dataclass(frozen=True)
class Group:
    """Fields that stand together. key: their name without number or axis. fields: indices, in their order."""

    key: str
    fields: tuple[int, ...]


def groups_of(names: Sequence[str]) -> list[Group]:
    """Fields that stand together by number, by axis, or by a common parent. names: paths of all fields."""
    keyed: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        leaf = name.rpartition(".")[2]
        if _EULER.search(leaf):
            keyed.setdefault(f"{name[: len(name) - len(leaf)]}{_EULER.sub('euler', leaf)}", []).append(index)
        elif (axis := _AXES.search(leaf)) and not _NUMBER.search(leaf):
            key = f"{name[: len(name) - len(leaf)]}{leaf[: axis.start(1)]}"
            keyed.setdefault(f"{key.rstrip('_')}~xyz", []).append(index)
        elif _NUMBER.search(name):
            keyed.setdefault(_NUMBER.sub("#", name), []).append(index)
        else:
            keyed.setdefault(f"{name.rpartition('.')[0]}.*", []).append(index)
    groups = [Group(key.removesuffix("~xyz").removesuffix(".*"), tuple(fields)) for key, fields in keyed.items()]
    return [group for group in groups if _MIN_ROTORS <= len(group.fields) <= MAX_NUMBERS]


def quantity_of_group(words: Sequence[str], names: Sequence[str], table: Floats) -> str | None:
    """The quantity that a group may be, None where it is none of a flight's.

    words: names that tell, the one that tells best first. names: of its fields. table: (n, k).
    """
    width = table.shape[1]
    table = np.where(np.abs(table) < MAX_VALUE, table, np.nan)
    if not np.isfinite(table).any():
        return None
    placed = sum(bool(_PLACES.search(name)) for name in names) == width
    for text in (*words, " ".join(words)):
        if _ROTOR.search(text) and not _OF_MOTORS.search(text):
            return _rotors(text, table) if width != 3 or not _axes(names) else _vector(words, table)
        if _OTHER.search(text):
            return None
    if width in (3, 4) and (vector := _vector(words, table)) is not None:
        return vector
    if any(_SETPOINT.search(text) for text in words) and not placed and not _all_turn(table):
        return None
    return _rotors(" ".join(words), table) if (placed or _all_turn(table)) and not _axes(names) else None


def _axes(names: Sequence[str]) -> bool:
    return all(_AXES.search(name.rpartition(".")[2]) for name in names)


def _vector(words: Sequence[str], table: Floats) -> str | None:
    """The quantity of three or four components."""
    is_setpoint = any(_SETPOINT.search(text) for text in words)
    length = np.linalg.norm(table, axis=1)
    length = length[np.isfinite(length)]
    if not len(length) or is_setpoint:
        return None
    if table.shape[1] == 4:
        return "attitude" if _is_unit(table) else None
    for text in words:
        for quantity, pattern in _VECTORS:
            if pattern.search(text):
                return quantity
    if _GRAVITY[0] < float(np.median(length)) < _GRAVITY[1]:
        return "specific_force"
    return None if _all_turn(table) else "rate"


def _all_turn(table: Floats) -> bool:
    """Whether the columns could be rotors': three or more move, of like sizes, each of one sign."""
    moving = moving_columns(table)
    if len(moving) < 3:
        return False
    part = table[:, moving]
    sizes = np.abs(np.nanmedian(part, axis=0))
    return bool(_of_one_sign(part).all() and sizes.max() < _ALIKE * max(sizes.min(), 1e-12))


def _of_one_sign(table: Floats) -> NDArray[np.bool_]:
    return np.asarray((np.nanmin(table, axis=0) >= 0.0) | (np.nanmax(table, axis=0) <= 0.0))


def _rotors(text: str, table: Floats) -> str | None:
    """Speeds or commands: by their name, else by their range."""
    if table.shape[1] > MAX_WIDTH + _MIN_ROTORS:
        return None
    if _SPEED.search(text):
        return "rotor_speed"
    low, high = float(np.nanmin(table)), float(np.nanmax(table))
    finite = table[np.isfinite(table)]
    is_pulse = low >= 0.0 and _PULSES[0] <= high <= _PULSES[1] and bool(np.all(finite == np.rint(finite)))
    is_fraction = low >= _FRACTION[0] and high <= _FRACTION[1]
    named = _ROTOR.search(text) and not re.search("rotor|propeller", text, re.IGNORECASE)
    return "rotor_command" if is_fraction or is_pulse or named else "rotor_speed"


def reason_for(quantity: str) -> str:
    """Why numbers that may be a quantity are not used as one."""
    words = "rotors" if quantity.startswith("rotor") else _IN_WORDS.get(quantity, f"a {quantity}")
    return f"no convention says that it is {words}"


def keep_groups(
    assembly: Assembly,
    source: str,
    names: Sequence[str],
    table: Floats,
    *,
    words: Sequence[str] = (),
    reason: str = "",
    count: int = 0,
    taken: Collection[str] = (),
) -> bool:
    """Keep the groups of a table as unused that may be a quantity; whether there was one.

    names: of the columns. table: (n, k). words: of the table itself, the one that tells best first.
    reason: empty for the one that suits the quantity. count: of samples, where the table has fewer.
    taken: quantities that are not looked for.
    """
    is_listed = False
    for group in _split(groups_of(names), table):
        fields = [names[index] for index in group.fields]
        part = table[:, group.fields]
        quantity = quantity_of_group([group.key, *words], fields, part)
        if quantity is not None and quantity not in taken:
            assembly.leave_out(quantity, source, fields, part, reason or reason_for(quantity), count=count)
            is_listed = True
    return is_listed


def _split(groups: Sequence[Group], table: Floats) -> list[Group]:
    """Groups, a row of several quantities in one array as its parts."""
    parts: list[Group] = []
    for group in groups:
        width = len(group.fields)
        mixed = width > 4 and not _ROTOR.search(group.key) and not _all_turn(table[:, group.fields])
        parts += _parts(group, table) if mixed else [group] if width <= MAX_WIDTH + _MIN_ROTORS else []
    return parts


def _parts(group: Group, table: Floats) -> list[Group]:
    """Quantities side by side in one array: a pose, accelerations and the rates after them, rotors; else the array.

    Each is told by its content: length 1 of an attitude, length g of a specific force, one sign of rotors.
    """
    left, parts = list(group.fields), []

    def take(key: str, start: int, count: int) -> None:
        parts.append(Group(key, tuple(left[start : start + count])))
        del left[start : start + count]

    turned = _first(left, 4, lambda part: _is_unit(part) and len(moving_columns(part)) > 1, table)
    if turned is not None:
        take("", turned, 4)
        if turned >= 3:
            take("position", turned - 3, 3)
    for count in range(8, 3, -1):
        rotors = _first(left, count, lambda part: _all_turn(part) and len(moving_columns(part)) == part.shape[1], table)
        if rotors is not None:
            take("", rotors, count)
            break
    force = _first(left, 3, lambda part: _GRAVITY[0] < float(np.nanmedian(_length(part))) < _GRAVITY[1], table)
    if force is not None:
        take("specific_force", force, 3)
        if force + 3 <= len(left):
            take("rate", force, 3)
    return parts or [group]


def _first(fields: Sequence[int], count: int, fits: Callable[[Floats], bool], table: Floats) -> int | None:
    """The first place of so many fields side by side that fit, None if there is none."""
    places = range(len(fields) - count + 1)
    return next((start for start in places if fits(table[:, fields[start : start + count]])), None)


def _length(table: Floats) -> Floats:
    return np.asarray(np.linalg.norm(table, axis=1))


def _is_unit(table: Floats) -> bool:
    return bool(np.mean(np.abs(_length(table) - 1.0) < _UNIT_LENGTH) > _UNIT_SHARE)
