"""acados' SQP_RTI on the problem that `beside_acados.py` hands over; runs in an environment of its own.

Reads commands on standard input, one JSON object a line: {"cases": FILE, "first": i, "last": j}; answers each with a
line of JSON: seconds per step as acados reports them (time_tot of preparation and of feedback), and the first input.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
from pathlib import Path

import casadi as ca
import numpy as np
from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

from dynamics import quaternion
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import GRAVITY, Vehicle
from dynamics.vehicle_file import read_vehicle
from export.network import Network
from export.symbolic import network_output


def nominal(vehicle: Vehicle, scale: float) -> tuple[ca.SX, ca.SX, ca.SX]:
    """State, scaled inputs and the state's derivative by the physical model."""
    model = build_model(vehicle)
    x, u = ca.SX.sym("x", model.state_count), ca.SX.sym("u", model.input_count)
    quiet = ca.SX.zeros(model.hidden_count)
    return x, u, model.derivative(x, scale * u, model.parameter_values, ENVIRONMENT_DEFAULT, quiet)


def learned(network: Network, scale: float) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Model by a network of one column, T = 1; unrolled as SX it is several times slower."""
    x, u = ca.MX.sym("x", 13), ca.MX.sym("u", network.rotors)
    accelerations = network_output(network, ca.vertcat(x, scale * u))
    force = quaternion.rotate(x[6:10], accelerations[0:3])  # specific force in body axes
    linear = force - ca.DM([0, 0, GRAVITY])
    return x, u, ca.vertcat(x[3:6], linear, quaternion.derivative(x[6:10], x[10:13]), accelerations[3:6])


def build(vehicle_file: str, problem: dict, condensing: str) -> tuple[AcadosOcpSolver, float]:
    vehicle = read_vehicle(vehicle_file)
    scale = 0.1 * vehicle.hover_speed
    if network_file := problem.get("network"):
        x, u, slope = learned(pickle.loads(Path(network_file).read_bytes()), scale)
    else:
        x, u, slope = nominal(vehicle, scale)
    nx, nu, nodes = x.shape[0], u.shape[0], problem["nodes"]
    model = AcadosModel()
    model.name, model.x, model.u, model.f_expl_expr = f"alula_{condensing.lower()}", x, u, slope
    ocp = AcadosOcp()
    ocp.model = model
    ocp.dims.N = nodes
    ocp.cost.cost_type, ocp.cost.cost_type_e = "LINEAR_LS", "LINEAR_LS"
    dt = problem["horizon"] / nodes
    ocp.cost.W = np.diag([*problem["Q"], *[weight * scale**2 for weight in problem["R"]]]) / dt
    ocp.cost.W_e = np.diag(problem["P"])
    ocp.cost.Vx, ocp.cost.Vu = np.eye(nx + nu, nx), np.vstack([np.zeros((nx, nu)), np.eye(nu)])
    ocp.cost.Vx_e = np.eye(nx)
    ocp.cost.yref, ocp.cost.yref_e = np.zeros(nx + nu), np.zeros(nx)
    ocp.constraints.lbu = np.array(problem["u_lower"]) / scale
    ocp.constraints.ubu = np.array(problem["u_upper"]) / scale
    ocp.constraints.idxbu = np.arange(nu)
    ocp.constraints.x0 = np.zeros(nx)
    if problem["rate_limits"]:
        ocp.constraints.idxbx = ocp.constraints.idxbx_e = np.arange(10, 13)
        ocp.constraints.ubx = ocp.constraints.ubx_e = np.array(problem["rate_limits"])
        ocp.constraints.lbx = ocp.constraints.lbx_e = -np.array(problem["rate_limits"])
        ocp.constraints.idxsbx = ocp.constraints.idxsbx_e = np.arange(3)
        price = np.full(3, problem["soft_penalty"])
        ocp.cost.zl = ocp.cost.zu = ocp.cost.Zl = ocp.cost.Zu = price / dt
        ocp.cost.zl_e = ocp.cost.zu_e = ocp.cost.Zl_e = ocp.cost.Zu_e = price
    options = ocp.solver_options
    options.tf, options.nlp_solver_type, options.hessian_approx = problem["horizon"], "SQP_RTI", "GAUSS_NEWTON"
    options.qp_solver, options.integrator_type = condensing, problem["integrator"]
    options.sim_method_num_stages, options.sim_method_num_steps = 4, 1
    options.levenberg_marquardt, options.qp_solver_iter_max = problem["levenberg_marquardt"], problem["iterations"]
    for name in ("stat", "eq", "ineq", "comp"):
        setattr(options, f"qp_solver_tol_{name}", problem["tolerance"])
    options.hpipm_mode = "SPEED"
    options.print_level = 0
    options.ext_fun_compile_flags = "-O3 -march=native"  # several times faster than its default for a network as MX
    return AcadosOcpSolver(ocp, json_file=f"{condensing.lower()}.json", verbose=False), scale


def run(solver: AcadosOcpSolver, scale: float, cases: dict, first: int, last: int) -> dict:
    nodes = cases["state_reference"].shape[1] - 1
    prepare, feedback, inputs, status = [], [], [], []
    for tick in range(first, last):
        for k in range(nodes):
            y = np.concatenate([cases["state_reference"][tick, k], cases["input_reference"][tick, k] / scale])
            solver.cost_set(k, "yref", y)
        solver.cost_set(nodes, "yref", cases["state_reference"][tick, nodes])
        solver.options_set("rti_phase", 1)
        solver.solve()
        prepare.append(float(np.ravel(solver.get_stats("time_tot"))[0]))
        solver.constraints_set(0, "lbx", cases["state"][tick])
        solver.constraints_set(0, "ubx", cases["state"][tick])
        solver.options_set("rti_phase", 2)
        status.append(int(solver.solve()))
        feedback.append(float(np.ravel(solver.get_stats("time_tot"))[0]))
        inputs.append((scale * solver.get(0, "u")).tolist())
    return {"prepare": prepare, "feedback": feedback, "inputs": inputs, "status": status}


def main() -> None:
    vehicle_file, problem_file, condensing, folder = sys.argv[1:5]
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # acados and its compiler print on standard output
    os.makedirs(folder, exist_ok=True)
    vehicle_file, problem = os.path.abspath(vehicle_file), json.loads(Path(problem_file).read_text())
    os.chdir(folder)
    solver, scale = build(vehicle_file, problem, condensing)
    cases = None
    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        if cases is None:
            cases = dict(np.load(request["cases"]))
            for k in range(problem["nodes"] + 1):
                solver.set(k, "x", cases["state"][0])
            for k in range(problem["nodes"]):
                solver.set(k, "u", np.full(cases["input_reference"].shape[2], cases["hover_speed"] / scale))
        print(json.dumps(run(solver, scale, cases, request["first"], request["last"])), file=answers, flush=True)


if __name__ == "__main__":
    main()
