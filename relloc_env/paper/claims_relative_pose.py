"""Claims of section III-B: the relative pose and its observation model."""

import math

import numpy as np

from relloc_env.kernels import relative_pose
from relloc_env.kernels.camera import image_flow
from relloc_env.kernels.motion import advance, relative
from relloc_env.paper.claim import Claim, Verdict, claim
from relloc_env.paper.claims_depth_filter import CASES, EXACT, STEP
from relloc_env.paper.runs import EXPERIMENT
from relloc_env.paper.studies import Studies
from relloc_env.samples import Float

SOURCE = "III-B"
TIMES = (-STEP, STEP)
"""[s] of central differences."""


def relative_pose_claims(studies: Studies) -> list[Claim]:
    """All claims of them."""
    return [*_dynamics(), *_observation(studies)]


def rotation(angle: float) -> Float:
    """The rotation matrix of an angle [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def _moved(pose: Float, u: Float, time: float) -> tuple[float, float, float]:
    """The pose after an exact arc."""
    x, y, theta = pose
    moved: tuple[float, float, float] = advance(x, y, theta, u[0], 0.0, u[1], time)
    return moved


def _slope(ends: list[Float]) -> Float:
    """Central difference of what was at `TIMES`."""
    return np.asarray((ends[1] - ends[0]) / (2.0 * STEP))


def _skew(rate: float) -> Float:
    return np.array([[0.0, -rate], [rate, 0.0]])


def _dynamics() -> list[Claim]:
    rng = np.random.default_rng(2)
    right, printed, turn, product_worst, turned_worst, relative_worst = (0.0,) * 6
    for _ in range(CASES):
        a, b = rng.uniform(-3.0, 3.0, 3), rng.uniform(-3.0, 3.0, 3)
        u_a, u_b = rng.uniform(0.05, 0.3, 2), rng.uniform(0.05, 0.3, 2)
        slope_a, slope_b = (_slope([np.array(_moved(p, u, t)) for t in TIMES]) for p, u in ((a, u_a), (b, u_b)))
        right = max(right, float(np.abs(slope_a[:2] - u_a[0] * np.array([math.cos(a[2]), math.sin(a[2])])).max()))
        printed = max(printed, abs(slope_a[0] - u_a[0] * math.sin(a[2])))
        turning = _slope([rotation(a[2] + u_a[1] * t) for t in TIMES])
        turn = max(turn, float(np.abs(turning - rotation(a[2]) @ _skew(u_a[1])).max()))
        change = _slope([np.array(relative(*_moved(a, u_a, t), *_moved(b, u_b, t))) for t in TIMES])
        if abs(change[2]) > 1.0:  # the angle was wrapped between the two
            continue
        r_x, r_y, theta = relative(*a, *b)
        carried = rotation(a[2]).T @ (slope_b - slope_a)[:2]
        spun = (rotation(a[2]) @ _skew(u_a[1])).T @ (b - a)[:2]
        rate = u_b[1] - u_a[1]
        product_worst = max(product_worst, float(np.abs(change - [*(spun + carried), rate]).max()))
        spun = -_skew(u_a[1]) @ (r_x, r_y)
        turned_worst = max(turned_worst, float(np.abs(change - [*(spun + carried), rate]).max()))
        model = (
            u_b[0] * math.cos(theta) - u_a[0] + u_a[1] * r_y,
            u_b[0] * math.sin(theta) - u_a[1] * r_x,
            rate,
        )
        relative_worst = max(relative_worst, float(np.abs(change - model).max()))
    return [
        claim(
            "robot-motion",
            "The dynamic of each robot is ṙ_A,x = v_A cos θ_A, ṙ_A,x = v_A sin θ_A, θ̇_A = w_A and ṙ_B,x = v_B cos "
            "θ_B, ṙ_B,y = v_B sin θ_B, θ̇_B = w_B.",
            SOURCE + ", eq. pose_inertial",
            {
                "with ṙ_A,y in the second line: greatest difference [m/s]": right,
                "as printed: greatest difference [m/s]": printed,
            },
            Verdict.of(right < EXACT and printed < EXACT),
            "Misprint: the second line is ṙ_A,y, which agrees with the exact arc.",
        ),
        claim(
            "rotation-derivative",
            "The dynamics of the relative pose is ξ̇ = [Ṙᵀ(θ_A)(r_B − r_A) + Rᵀ(θ_A)(ṙ_B − ṙ_A); θ̇_B − θ̇_A], where "
            "Ṙ(a) = R(a) S(ȧ), R(a) = [cos a, −sin a; sin a, cos a], and S(ȧ) = [0, −ȧ; ȧ, 0].",
            SOURCE + ", eq. dynamic_01, matrices_definition",
            {"Ṙ: greatest difference [1/s]": turn, "ξ̇: greatest difference [m/s, rad/s]": product_worst},
            Verdict.of(max(turn, product_worst) < EXACT),
            f"Against central differences of two exact arcs, {CASES} random states.",
        ),
        claim(
            "relative-derivative",
            "Substituting (rel_pose) in (dynamic_01) yields ξ̇ = [−S(θ̇_A) r + Rᵀ(θ_A)(ṙ_B − ṙ_A); θ̇_B − θ̇_A].",
            SOURCE + ", eq. rotation_matrix",
            {"greatest difference [m/s, rad/s]": turned_worst},
            Verdict.of(turned_worst < EXACT),
            "Checked as above.",
        ),
        claim(
            "relative-dynamics",
            "Finally, applying (pose_inertial) and (matrices_definition) in the previous equation leads to the dynamic "
            "model ξ̇ = f(ξ, u_A, u_B) = [v_B cos θ − v_A + w_A r_y; v_B sin θ − w_A r_x; w_B − w_A].",
            SOURCE + ", eq. state_model",
            {"greatest difference [m/s, rad/s]": relative_worst},
            Verdict.of(relative_worst < EXACT),
            "Checked as above.",
        ),
    ]


def _observation(studies: Studies) -> list[Claim]:
    run = studies.experiment
    (v_a, w_a), (v_b, w_b) = EXPERIMENT
    image_residual, plane_residual, slope_residual, chi_residual, model_residual = 0.0, 0.0, 0.0, 0.0, math.inf
    for k in range(0, len(run.time), 10):
        a, b = run.robots[0, k]
        r_x, r_y, theta = relative(*a, *b)
        r, rot = np.array([r_x, r_y]), rotation(theta)
        change = np.array(relative_pose.derivative(r_x, r_y, theta, v_a, 0.0, w_a, v_b, 0.0, w_b))[:2]
        for i, target in enumerate(run.targets[:, :2]):
            q_a, q_b = rotation(a[2]).T @ (target - a[:2]), rotation(b[2]).T @ (target - b[:2])
            s_a, s_b = run.depth[0, k, :, i, None] * run.image[0, k, :, i]
            image_residual = max(image_residual, float(np.linalg.norm(s_a - rot @ s_b - r)))
            plane_residual = max(plane_residual, float(np.linalg.norm(q_a - rot @ q_b - r)))
            flow_a, flow_b = -_skew(w_a) @ q_a - (v_a, 0.0), -_skew(w_b) @ q_b - (v_b, 0.0)
            measured = _skew(w_b - w_a) @ q_b + flow_b
            slope_residual = max(slope_residual, float(np.linalg.norm(flow_a - rot @ measured - change)))
            by_chi = [
                _plane_flow(run.image[0, k, j, i], 1.0 / run.depth[0, k, j, i], u) for j, u in enumerate(EXPERIMENT)
            ]
            printed_flow = by_chi[0] - rot @ (_skew(w_b - w_a) @ q_b + by_chi[1])
            chi_residual = max(chi_residual, float(np.linalg.norm(printed_flow - change)))
            model_residual = min(model_residual, float(np.linalg.norm(measured - rot.T @ flow_a)))
    step = float(run.time[1] - run.time[0])
    eigenvalues = {
        model: least_information(run.robots[0], run.targets[:, :2], step, model)
        for model in ("printed", "velocity", "position")
    }
    ends = {name: run.tracks[name] for name in ("printed", "velocity")}
    return [
        claim(
            "point-in-both-frames",
            "From the geometric perspective, the following equation holds for each of the m-points: r = z̄_A s_A − "
            "R(θ) z̄_B s_B, for which the corresponding time derivative is ṙ = z̄̇_A s_A + z̄_A ṡ_A − R(θ) [S(θ̇) z̄_B "
            "s_B + z̄̇_B s_B + z̄_B ṡ_B].",
            SOURCE,
            {
                "residual, s as defined [m]": image_residual,
                "residual, q = z̄ [1, −x] for z̄ s [m]": plane_residual,
                "residual of the derivative, with q [m/s]": slope_residual,
            },
            Verdict.of(max(image_residual, slope_residual) < EXACT),
            "The second image coordinate is vertical; a point in the plane of the body frame is meant, q = (1/χ) [1, "
            "−x] (x forward, y left). The code uses q. At the true poses of the experiment, q̇ = −w J q − v e₁.",
        ),
        claim(
            "point-derivative",
            "By replacing z̄̇ = −χ̇/χ², it is possible to describe the relationship between the dynamics of 3D points "
            "… and the dynamics of the relative pose: ṙ = −χ̇_A/χ_A² s_A + ṡ_A/χ_A − R(θ) [S(θ̇) s_B/χ_B − χ̇_B/χ_B² "
            "s_B + ṡ_B/χ_B].",
            SOURCE,
            {
                "residual, s as defined [m]": image_residual,
                "residual, [1, −x] for s [m/s]": chi_residual,
            },
            Verdict.of(max(image_residual, chi_residual) < EXACT),
            "The same misprint: with [1, −x] in the place of s it holds.",
        ),
        claim(
            "observation-model",
            "If vehicle A periodically estimates (s_A, χ_A) and their dynamics, and receives the corresponding "
            "estimates from vehicle B, the following observation model holds: h_i(ξ) = Rᵀ(θ) [z̄̇_A s_A + z̄_A ṡ_A].",
            SOURCE,
            {
                "least |π − h| at the true pose [m/s]": model_residual,
                "least information of the printed model": eigenvalues["printed"],
                "of `velocity`": eigenvalues["velocity"],
                "of `position`": eigenvalues["position"],
            }
            | {f"`{name}`: A→B after 40 s [m]": one.position[0, -1, 0] for name, one in ends.items()}
            | {f"`{name}`: A→B after 40 s [deg]": one.heading[0, -1, 0] for name, one in ends.items()},
            Verdict.of(model_residual < EXACT),
            "With q for z̄ s. −R(θ)ᵀ ṙ is missing: with it (model `velocity`) π = h. Without it the model is biased "
            "and does not contain r, which no motion makes observable: it cannot produce the results shown. "
            "Information: least eigenvalue of ∫HᵀH dt over the 40 s, in the units of each measurement. The default, "
            "`position`, takes q_B for π and R(θ)ᵀ (q_A − r) for h; `velocity` holds w_A² times its information.",
        ),
    ]


def _plane_flow(image: Float, chi: float, u: tuple[float, float]) -> Float:
    """[m/s] −χ̇/χ² [1, −x] + [0, −ẋ]/χ: how a point moves in the plane, from how its image does."""
    x_flow, _, chi_flow = image_flow(image[0], image[1], chi, u[0], 0.0, u[1])
    return np.array([-chi_flow / chi**2, chi_flow / chi**2 * image[0] - x_flow / chi])


def least_information(robots: Float, targets: Float, step: float, model: str) -> float:
    """Least eigenvalue of ∫HᵀH dt over a run at the experiment's inputs, about the pose at its start.

    Args:
        robots: [m, m, rad] (T, 2, 3) true poses of A and B.
        targets: [m] (M, 2) in the world.
        step: [s] between samples.
        model: name of the observation model.
    """
    number = {"position": relative_pose.POSITION, "velocity": relative_pose.VELOCITY, "printed": relative_pose.PRINTED}
    (v_a, w_a), (v_b, w_b) = EXPERIMENT
    total, transition = np.zeros((3, 3)), np.eye(3)
    for a, b in robots:
        r_x, r_y, theta = relative(*a, *b)
        cos, sin = math.cos(theta), math.sin(theta)
        for target in targets:
            q_a, q_b = rotation(a[2]).T @ (target - a[:2]), rotation(b[2]).T @ (target - b[:2])
            row = relative_pose.observe(
                number[model], r_x, r_y, cos, sin, q_a[0], q_a[1], q_b[0], q_b[1], v_a, 0.0, w_a, v_b, 0.0
            )[2:]
            jacobian = np.array(row).reshape(2, 3) @ transition
            total += jacobian.T @ jacobian
        displacement = (*advance(0.0, 0.0, 0.0, v_a, 0.0, w_a, step), *advance(0.0, 0.0, 0.0, v_b, 0.0, w_b, step))
        *_, d_x, d_y = relative_pose.predict(r_x, r_y, theta, *displacement)
        forward = np.eye(3)
        forward[:2, :2], forward[:2, 2] = rotation(-w_a * step), (-d_y, d_x)
        transition = forward @ transition
    return max(0.0, step * float(np.linalg.eigvalsh(total)[0]))
