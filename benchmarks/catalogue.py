"""Catalogue of the measurements: theme and name of each, its function, its pages, and the code that it measures.

Nothing heavy is imported here: `.ci/result_ages.py` reads this table on every lint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

NOT_KEPT = ("--kept", "/dev/null")
FLIGHT = ("simulation", "sitl_mock", "runtime/control", "runtime/flight", "dynamics/references")
WHOLE_FLIGHT = (*FLIGHT, "simulation/whole_flight.py", "runtime/flight_setup.py")
KERNEL = ("runtime/control/rti", "export")
DIAGNOSIS = ("diagnosis", "dynamics/effects", "flights")


@dataclass(frozen=True)
class Measurement:
    """A measurement.

    function: "module:name"; it takes the words of a command line, and returns a `Page` or None.
    pages: names in benchmarks/results that it writes.
    of: packages and files that it measures.
    quick: options of its smallest form.
    needs: what has to be there before, in words.
    in_study: whether `make study` takes it.
    """

    function: str
    pages: tuple[str, ...]
    of: tuple[str, ...]
    quick: tuple[str, ...] = ()
    needs: str = ""
    in_study: bool = True


CAMPAIGN = "`alula campaign --out build/campaign_learning`"
THEMES: Mapping[str, Mapping[str, Measurement]] = {
    "adaptation": {
        "tracking": Measurement(
            "benchmarks.adaptation.tracking:tracking", ("adaptation",), FLIGHT, ("--cases", "1", *NOT_KEPT)
        ),
        "cost": Measurement(
            "benchmarks.adaptation.tracking:cost",
            ("adaptation_cost",),
            ("runtime/control", "runtime/flight"),
            ("--repeats", "1", "--seconds", "4"),
        ),
        "link": Measurement(
            "benchmarks.adaptation.link:link",
            ("adaptation_link",),
            ("runtime", "sitl_mock"),
            ("--cases", "1", *NOT_KEPT),
        ),
        "nothing_hidden": Measurement(
            "benchmarks.adaptation.nothing_hidden:nothing_hidden",
            ("nothing_hidden",),
            FLIGHT,
            ("--cases", "2", *NOT_KEPT),
        ),
        "witness": Measurement(
            "benchmarks.adaptation.witness:witness",
            ("witness",),
            ("runtime/control", "runtime/flight"),
            ("--cases", "1", *NOT_KEPT),
        ),
        "estimates": Measurement(
            "benchmarks.adaptation.estimates:estimates",
            ("flight_estimates",),
            (*FLIGHT, "diagnosis"),
            ("--seeds", "1", "--jobs", "1", *NOT_KEPT),
        ),
        "parameters": Measurement(
            "benchmarks.adaptation.names:parameters", ("named_parameters",), FLIGHT, ("--cases", "1", *NOT_KEPT)
        ),
        "wind": Measurement(
            "benchmarks.adaptation.names:wind", ("steady_wind",), FLIGHT, ("--flights", "1", *NOT_KEPT)
        ),
        "neural_fly": Measurement(
            "benchmarks.adaptation.neural_fly:neural_fly", ("neural_fly",), FLIGHT, ("--cases", "1", *NOT_KEPT)
        ),
        "payload": Measurement(
            "benchmarks.adaptation.payload:payload", ("payload",), FLIGHT, ("--cases", "2", *NOT_KEPT)
        ),
    },
    "rotor_loss": {
        "lockstep": Measurement(
            "benchmarks.rotor_loss:lockstep",
            ("rotor_loss",),
            FLIGHT,
            ("--flights", "1", "--others", "1", "--jobs", "1", *NOT_KEPT),
        ),
        "link": Measurement(
            "benchmarks.rotor_loss:link",
            ("rotor_loss_link",),
            (*WHOLE_FLIGHT, "runtime/link"),
            ("--flights", "2", "--udp", "0", *NOT_KEPT),
        ),
    },
    "faults": {
        "study": Measurement(
            "benchmarks.faults:study",
            ("faults",),
            (*WHOLE_FLIGHT, "runtime/link", "fixtures/fault_flights.py", "fixtures/fault_cases"),
            ("--seeds", "1", "--cases", "1", "--models", "nominal", *NOT_KEPT),
        ),
    },
    "landing": {
        "landings": Measurement(
            "benchmarks.landing.landings:landings", ("landings",), WHOLE_FLIGHT, ("--flights", "1")
        ),
        "crashes": Measurement(
            "benchmarks.landing.crashes:crashes",
            ("crash_detector",),
            WHOLE_FLIGHT,
            ("--flights", "1", "--crashes", "1"),
        ),
        "start_height": Measurement(
            "benchmarks.landing.start_height:start_height", ("start_height",), WHOLE_FLIGHT, ("--flights", "1")
        ),
        "thrust": Measurement(
            "benchmarks.landing.thrust:thrust", ("thrust_in_the_air",), WHOLE_FLIGHT, ("--flights", "2", *NOT_KEPT)
        ),
    },
    "link": {
        "flood": Measurement(
            "benchmarks.link.flood:flood",
            ("flood", "flood_signed"),
            ("runtime/link",),
            ("--seconds", "0.5", "--rates", "5000"),
        ),
        "parsing": Measurement(
            "benchmarks.link.parsing:parsing", ("link_parsing",), ("runtime/link",), ("--repeats", "1")
        ),
        "timing": Measurement(
            "benchmarks.link.daemon:timing",
            ("flight_timing",),
            ("runtime",),
            ("--minutes-100", "0.05", "--minutes-200", "0.05"),
        ),
        "tick": Measurement("benchmarks.link.tick:tick", ("tick",), ("runtime",), ("--seconds", "2", "--rates", "100")),
        "recorder": Measurement(
            "benchmarks.link.daemon:recorder", ("recorder_cost",), ("runtime/record",), ("--seconds", "1")
        ),
        "soak": Measurement(
            "benchmarks.link.soak:soak", ("soak",), ("runtime",), ("--minutes", "0.1", "--limited-minutes", "0.1")
        ),
        "clock": Measurement("benchmarks.link.daemon:clock", ("clock_filter",), ("runtime/link",), ("--seeds", "1")),
    },
    "kernel": {
        "fixed_cost": Measurement(
            "benchmarks.kernel.fixed_cost:fixed_cost", ("fixed_cost",), KERNEL, ("--rounds", "20")
        ),
        "network": Measurement(
            "benchmarks.kernel.network:network",
            ("rti_network",),
            KERNEL,
            ("--networks", "build/rti_network_trial", "--steps", "300"),
        ),
        "box_qp": Measurement("benchmarks.kernel.box_qp:box_qp", ("box_qp",), KERNEL),
        "limits": Measurement("benchmarks.kernel.limits:limits", ("limits",), KERNEL, ("--problems", "1600")),
        "programs": Measurement(
            "benchmarks.kernel.programs:programs",
            ("programs",),
            KERNEL,
            ("--draws", "5", "--flights", "1", *NOT_KEPT),
        ),
        "jitter": Measurement(
            "benchmarks.kernel.jitter:jitter", ("rti_jitter", "rti_jitter_network"), KERNEL, ("--seconds", "2")
        ),
        "acados": Measurement(
            "benchmarks.kernel.beside_acados:nominal", ("rti_against_acados",), KERNEL, ("--ticks", "50")
        ),
        "acados_mlp": Measurement(
            "benchmarks.kernel.beside_acados:learned", ("mlp_against_acados",), KERNEL, ("--ticks", "50")
        ),
    },
    "learning": {
        "studies": Measurement(
            "benchmarks.learning.studies:studies",
            ("learning",),
            ("training", "studies"),
            ("--only-finished",),
            needs=f"{CAMPAIGN} and `alula campaign --no-effects --out build/campaign_nominal`",
        ),
        "goals": Measurement("benchmarks.learning.goals:goals", ("learning_goals",), ("training",), needs=CAMPAIGN),
        "diagnosed_base": Measurement(
            "benchmarks.learning.goals:diagnosed_base", ("diagnosed_base",), ("training", "diagnosis"), needs=CAMPAIGN
        ),
        "networks_that_fly": Measurement(
            "benchmarks.learning.goals:networks_that_fly",
            ("networks_that_fly",),
            ("training", "export", *FLIGHT),
            needs=CAMPAIGN,
        ),
        "evaluated": Measurement(
            "benchmarks.learning.goals:evaluated",
            ("evaluated_models",),
            ("training", "studies/evaluation", "vehicles"),
            needs=CAMPAIGN,
        ),
        "labels": Measurement(
            "benchmarks.learning.labels:labels",
            ("acceleration_labels",),
            ("training/data", "simulation/campaign.py"),
            ("--flights", "1", "--jobs", "1"),
        ),
    },
    "network": {
        "in_flight": Measurement(
            "benchmarks.network:in_flight",
            ("network_in_flight",),
            ("export", "training", *FLIGHT),
            ("--cases", "1", *NOT_KEPT),
            needs=CAMPAIGN,
        ),
        "uncertainty": Measurement(
            "benchmarks.network:uncertainty", ("network_uncertainty",), ("export", "training"), needs=CAMPAIGN
        ),
    },
    "tracking": {
        "table_two": Measurement(
            "benchmarks.tracking.table_two:table_two",
            ("table_two", "table_two_px4"),
            ("runtime", "sitl_mock", "simulation", "vehicles"),
            ("--lockstep", "--runs", "1", "--models", "nominal", "--manoeuvres", "Ellipse_1", "--jobs", "1"),
            needs=f"{CAMPAIGN} for the model with effects",
        ),
        "manoeuvres": Measurement(
            "benchmarks.tracking.manoeuvres:manoeuvres",
            ("manoeuvres",),
            ("runtime", "sitl_mock"),
            ("--runs", "1", "--manoeuvres", "Ellipse_1"),
        ),
        "px4": Measurement(
            "benchmarks.tracking.px4:px4", ("px4_tracking",), WHOLE_FLIGHT, ("--flights", "1", "--references", "hover")
        ),
        "oscillation": Measurement(
            "benchmarks.tracking.controller:oscillation",
            ("oscillation",),
            ("runtime/flight/health.py", "runtime/control", "vehicles"),
            ("--noise", "1", "--models", "nominal", "--manoeuvres", "Lemniscate"),
        ),
        "horizons": Measurement(
            "benchmarks.tracking.horizons:horizons",
            ("horizons",),
            ("runtime/control/rti", "runtime/control/controller.py", "dynamics/controller_settings.py"),
            ("--cases", "5", *NOT_KEPT),
        ),
        "lookaheads": Measurement(
            "benchmarks.tracking.controller:lookaheads",
            ("controller_defaults",),
            ("dynamics/controller_defaults.py", "dynamics/rate_loop.py", "runtime/control"),
            ("--seeds", "1", "--references", "hover:laps=1"),
        ),
        "damping": Measurement(
            "benchmarks.tracking.controller:damping",
            ("closed_loop",),
            ("runtime/control/closed_loop.py", "dynamics/rate_loop.py", "dynamics/controller_defaults.py"),
            ("--vehicles", "arpl_250g"),
        ),
    },
    "simulator": {
        "load": Measurement("benchmarks.simulator:load", ("mock_load",), ("sitl_mock",), ("--seconds", "1")),
        "speed": Measurement(
            "benchmarks.simulator:speed", ("mock_speed",), ("sitl_mock/vehicle",), ("--seconds", "0.5")
        ),
        "lockstep": Measurement(
            "benchmarks.simulator:lockstep",
            ("lockstep_speed",),
            ("simulation", "sitl_mock/vehicle", "runtime/control", "runtime/flight"),
            ("--repeats", "1"),
        ),
    },
    "campaign": {
        "speed": Measurement(
            "benchmarks.campaign:speed",
            ("campaign_speed",),
            ("simulation", "sitl_mock/vehicle", "training/data"),
            ("--flights", "Ellipse_1", "--jobs", "1"),
        ),
        "references": Measurement(
            "benchmarks.campaign:references",
            ("references",),
            ("dynamics/references", "simulation", "training/data"),
            ("--manoeuvres", "Ellipse_1"),
        ),
    },
    "studio": {
        "speed": Measurement("benchmarks.studio:speed", ("studio",), ("studio",), ("--additions", "1")),
        "large_logs": Measurement(
            "benchmarks.studio:large_logs", ("studio_large_logs",), ("studio", "flights"), ("--size", "0.02")
        ),
    },
    "readers": {
        "reading": Measurement(
            "benchmarks.readers:reading",
            ("read_flights",),
            ("flights",),
            ("--no-speed", "tests/data/imrc_lee_crazyflie"),
        ),
        "delays": Measurement(
            "benchmarks.readers:delays",
            ("delay_estimation",),
            ("flights/delays.py", "flights/delay_fit.py"),
            ("--flights", "1", "--jobs", "1"),
        ),
        "wrong_columns": Measurement(
            "benchmarks.wrong_columns:wrong_columns",
            ("wrong_columns",),
            ("flights/hypotheses", "flights/plausibility.py"),
            ("--logs", "2", "--recordings", "tests/data/nanobench"),
        ),
        "health": Measurement(
            "benchmarks.flight_health:flight_health",
            ("flight_health",),
            ("flights/health",),
            ("--cases", "1", *NOT_KEPT),
        ),
        "rotor_orders": Measurement(
            "benchmarks.readers:rotor_orders", ("rotor_orders",), ("diagnosis/data",), ("--sets", "1")
        ),
    },
    "public_sets": {
        "score": Measurement(
            "benchmarks.public_sets:score",
            ("public_sets",),
            DIAGNOSIS,
            ("--flights", "2"),
            needs="a folder of downloads",
            in_study=False,
        ),
    },
    "fleet": {
        "fleet": Measurement(
            "benchmarks.fleet:fleet",
            ("fleet",),
            ("diagnosis", "flights/parallel.py", "alula"),
            ("--logs", "20", "--one", "2", "--cluster", "4"),
        ),
    },
    "commands": {
        "bad_inputs": Measurement("benchmarks.commands:bad_inputs", ("bad_inputs",), ("alula",), ("--only", "vehicle")),
        "install_size": Measurement(
            "benchmarks.commands:install_size",
            ("base_install_size",),
            ("pyproject.toml", "constraints.txt", "setup.py"),
            ("--starts", "1"),
        ),
    },
    "demo": {
        "gain": Measurement(
            "benchmarks.demo:gain",
            ("demo_gain",),
            ("studies/demo", *DIAGNOSIS, *FLIGHT),
            ("--seeds", "0", "--effects", "rotor_drag", "--keep", "build/quick_demo_gain"),
        ),
        "draws": Measurement(
            "benchmarks.demo:draws",
            ("hidden_effect_draws",),
            (*DIAGNOSIS, "alula"),
            ("--seeds", "1", "--first", "1", "--draws", "0"),
        ),
        "busy": Measurement(
            "benchmarks.demo:busy",
            ("demo_busy",),
            ("studies/demo", *DIAGNOSIS, *FLIGHT),
            ("--demos", "1", "--loops", "0", "--kept", "build/quick_demo_busy.jsonl"),
        ),
    },
    "estimation": {
        "identification_flight": Measurement(
            "benchmarks.estimation.identification_flight:identification_flight",
            ("identification_flight",),
            ("dynamics/references", *DIAGNOSIS),
            ("--flights", "1", "--cases", "1", *NOT_KEPT),
        ),
        "vehicle_from_logs": Measurement(
            "benchmarks.estimation.vehicle_from_logs:vehicle_from_logs",
            ("vehicle_from_logs",),
            ("diagnosis",),
            ("--sets", "1"),
        ),
    },
    "thresholds": {
        "margins": Measurement(
            "benchmarks.thresholds:margins",
            ("threshold_margins",),
            DIAGNOSIS,
            ("--cases", "1", "--budget", "0", *NOT_KEPT),
        ),
    },
    "last_setpoint": {
        "deaths": Measurement(
            "benchmarks.last_setpoint:deaths",
            ("last_setpoint",),
            ("runtime/control/rti/last_setpoint.h", "runtime/flight/last_setpoint.py", "sitl_mock/vehicle"),
            ("--flights", "1", "--each", "2", *NOT_KEPT),
        ),
        "kills": Measurement(
            "benchmarks.last_setpoint:kills",
            ("last_setpoint_kills",),
            ("runtime/control/rti/last_setpoint.h", "runtime/flight/last_setpoint.py", "runtime"),
            ("--kills", "1", *NOT_KEPT),
        ),
    },
    "mutation": {
        "tests_kill": Measurement(
            "benchmarks.mutation.tests_kill:tests_kill",
            ("mutants",),
            ("tests/runtime/flight", "tests/dynamics", "tests/flights"),
            ("--files", "1", "--cases", "1", *NOT_KEPT),
            needs="the whole history of this repository",
            in_study=False,
        ),
    },
    "diagnosis": {
        "speed": Measurement(
            "benchmarks.diagnosis:speed",
            ("diagnosis_speed",),
            ("diagnosis",),
            ("--kind", "rotor drag, nine flights"),
        ),
        "additions": Measurement(
            "benchmarks.diagnosis:additions", ("additions",), DIAGNOSIS, ("--loops", "1", *NOT_KEPT)
        ),
    },
}
SCRIPTS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {  # that still have a command of their own
    "px4_estimate": (("px4_estimate",), ("sitl_mock/vehicle",)),
    "verdict": (("verdict",), DIAGNOSIS),
}


def measured_code() -> dict[str, tuple[str, ...]]:
    """Packages and files that each page of results measures."""
    pages = {page: m.of for theme in THEMES.values() for m in theme.values() for page in m.pages}
    return pages | {page: of for written, of in SCRIPTS.values() for page in written}
