"""Components of a user's own: one Python file with a `COMPONENT` in it, or several as `COMPONENTS`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from diagnosis.noise.component import Component, FlightConditions
from diagnosis.noise.components import CATALOGUE
from diagnosis.noise.composition import Composition
from dynamics.effect_source import EffectFile
from dynamics.errors import RequestError
from dynamics.own_effects import line_of
from dynamics.trust import run_effect_file

FREQUENCIES = np.geomspace(1e-2, 1e2, 25)  # Hz, at which spectrum and state space are compared
AGREEMENT = 1e-6  # of a density: rounding


def catalogue_with(files: Iterable[EffectFile], conditions: FlightConditions) -> Mapping[str, Component]:
    """The catalogue and the components of further files, each tried in hover at its usual values.

    Raises RequestError for a file that is not approved or defines none, a name that is taken, a component that fails,
    or one whose spectrum is not that of its state space.
    """
    catalogue = dict(CATALOGUE)
    own: list[tuple[EffectFile, Component]] = []
    for file in files:
        for component in components_of(file):
            if component.name in catalogue:
                raise RequestError(
                    f"{file.path}: there is a component {component.name!r} already; give yours another name."
                )
            catalogue[component.name] = component
            own.append((file, component))
    for file, component in own:
        try:
            check(component, catalogue, conditions)
        except Exception as error:  # a user's functions may raise anything
            line = line_of(error, file)
            where = f"{file.path}, line {line}" if line else file.path
            raise RequestError(f"{where}: component {component.name!r}: {type(error).__name__}: {error}") from None
    return catalogue


def components_of(file: EffectFile) -> tuple[Component, ...]:
    """The components that an approved file defines. Raises RequestError when it cannot be run or defines none."""
    try:
        names = run_effect_file(file)
    except RequestError:
        raise
    except Exception as error:  # a user's file may raise anything
        line = error.lineno if isinstance(error, SyntaxError) else line_of(error, file)
        raise RequestError(f"{file.path}, line {line or '?'}: {type(error).__name__}: {error}") from None
    defined = names.get("COMPONENTS", names.get("COMPONENT"))
    components = tuple(defined) if isinstance(defined, Iterable) else (defined,)
    if not components or not all(isinstance(component, Component) for component in components):
        raise RequestError(
            f"{file.path} defines no COMPONENT that is a diagnosis.noise.component.Component. "
            "diagnosis/noise/components/gyro.py is a short example."
        )
    return components


def check(component: Component, catalogue: Mapping[str, Component], conditions: FlightConditions) -> None:
    """Compare a component's spectrum with its state space. Raises ValueError where they differ, or one is no number."""
    if unknown := set(component.needs) - set(catalogue):
        raise ValueError(f"it needs {', '.join(sorted(unknown))}; there are {', '.join(catalogue)}")
    composition = Composition((component, *(catalogue[name] for name in component.needs)))
    values = composition.medians(conditions.vehicle)
    model = composition.model(values, conditions)
    spectrum = composition.spectrum(values, conditions, FREQUENCIES)
    if spectrum.keys() != set(model.outputs):
        raise ValueError(f"its spectrum is of {sorted(spectrum)}, its model of {sorted(model.outputs)}")
    model.start_covariance()
    density = model.density(FREQUENCIES, conditions.period)
    for place, output in enumerate(model.outputs):
        closed, transfer = spectrum[output], density[:, place, place].real
        if not np.allclose(closed, transfer, rtol=AGREEMENT, atol=0.0):
            worst = int(np.argmax(~np.isclose(closed, transfer, rtol=AGREEMENT, atol=0.0)))
            raise ValueError(
                f"its spectrum of {output} at {FREQUENCIES[worst]:.3g} Hz is {closed[worst]:.6g}, "
                f"its state space gives {transfer[worst]:.6g}"
            )
