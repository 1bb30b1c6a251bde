"""Runs of a robot in MuJoCo under its sampled controller: NumPy and MuJoCo only, for processes without JAX.

    python _mujoco_loop.py JOB.npz FIRST LAST RESULT.npz

plays runs FIRST to LAST - 1 of a job that `_mujoco_records` wrote, `chunk` of them side by side: MuJoCo steps one
after the other, everything else is one array operation for all. Run number = position * experiments + experiment.
Prints the part that is done, line by line.
"""

import sys

import mujoco
import numpy as np

SEGMENT = 2000  # samples between two looks at the runs
ASTRAY = 0.3  # rad on the arm side between reference and motion
INSIDE, CORNER = 1e-3, 0.05  # of stiffness inside a gap, of the gap: the rounding that the robot's file states


class Ripple:
    """sum_h amplitude_h sin(order_h angle + phase_h) of every axis, from arrays (axis, order)."""

    def __init__(self, table):
        amplitude, order, self.phase = table[0], table[1], table[2].ravel()
        axes, orders = amplitude.shape
        self.spread = np.kron(np.eye(axes), np.ones((1, orders))) * order.ravel()
        self.gather = np.kron(np.eye(axes), np.ones((orders, 1))) * amplitude.ravel()[:, None]
        self.acts = bool(np.any(amplitude))

    def __call__(self, angle):
        phase = angle @ self.spread
        phase += self.phase
        return np.sin(phase, out=phase) @ self.gather


class Cascade:
    """The controller of the robot's file, (run, axis) at once: P on position, PI on velocity, limited."""

    def __init__(self, job, reading, torque):
        self.kp, self.kv, self.limit = float(job["position_gain"]), job["velocity_gain"], job["torque_limit"]
        self.feedforward, self.fs = bool(job["feedforward"]), float(job["fs"])
        self.rate = 1.0 / (self.fs * float(job["integral_time"]))
        held = (self.kv > 0) & (self.rate > 0)
        self.integral = np.where(held, torque / np.where(held, self.kv, 1.0), 0.0)
        self.last = reading

    def __call__(self, reading, position, velocity):
        error = self.kp * (position - reading)
        error -= self.fs * (reading - self.last)
        if self.feedforward:
            error += velocity
        self.integral += self.rate * error
        self.last = reading
        return np.clip(self.kv * (error + self.integral), -self.limit, self.limit)


class Springs:
    """What nonlinear springs pull beyond the linear ones that MuJoCo has, N m."""

    def __init__(self, job):
        self.stiffness, self.damping, self.knee = job["spring_stiffness"], job["spring_damping"], job["spring_knee"]
        self.soft = self.stiffness * (1.0 - job["spring_ratio"]) * self.knee
        self.gap = job["spring_gap"]
        self.play = bool(np.any(self.gap > 0))
        self.corner = np.where(self.gap > 0, CORNER * self.gap, 1.0)

    def __call__(self, x, rate):
        if not self.play:
            return -self.soft * np.tanh(x / self.knee)
        right, left = (x + 0.5 * self.gap) / self.corner, (x - 0.5 * self.gap) / self.corner
        lost = 0.5 * self.corner * (np.logaddexp(right, -right) - np.logaddexp(left, -left))
        slack = 0.5 * (np.tanh(right) - np.tanh(left))
        lost, slack = (np.where(self.gap > 0, (1.0 - INSIDE) * part, 0.0) for part in (lost, slack))
        beyond = x - lost
        return -self.stiffness * lost - self.soft * np.tanh(beyond / self.knee) - self.damping * slack * rate


class Rubbing:
    """Friction effects beyond MuJoCo's own law: rows (kind, axis, three numbers), torque against the motors."""

    def __init__(self, rows):
        self.rows = [(int(row[0]), int(row[1]), *row[2:]) for row in rows]

    def __call__(self, speed, load):
        total = np.zeros_like(speed)
        for kind, axis, a, b, smoothing in self.rows:
            v = speed[:, axis]
            side = np.tanh(v / smoothing)
            level = (a * np.exp(-np.square(v / b)), b, a * np.abs(load[:, axis]))[kind]
            total[:, axis] += level * side + (a if kind == 1 else 0.0)
        return total


class Actuators:
    """Motor torque in every substep from the commands: gain, clipping, and a delay or lag as a sum over the past."""

    def __init__(self, job, torque):
        self.gain, self.limit = job["actuator_gain"], job["actuator_limit"]
        self.weight = job["actuator_weight"]  # (substep, sample ago, axis)
        self.plain = np.all(self.gain == 1.0) and np.all(np.isinf(self.limit))
        self.late = self.weight.shape[1] > 1
        self.past = np.repeat(self._now(torque)[:, None], self.weight.shape[1], axis=1)

    def _now(self, torque):
        return torque if self.plain else np.clip(self.gain * torque, -self.limit, self.limit)

    def __call__(self, torque):
        """(substep, run, axis)."""
        torque = self._now(torque)
        if not self.late:
            return [torque] * len(self.weight)
        self.past[:, 1:] = self.past[:, :-1]
        self.past[:, 0] = torque
        return np.einsum("ska,rka->sra", self.weight, self.past)


class Runs:
    """Some runs side by side."""

    def __init__(self, job, runs):
        self.job, self.runs = job, runs
        self.model = mujoco.MjModel.from_xml_string(str(job["xml"]))
        self.data = [mujoco.MjData(self.model) for _ in runs]
        n_exp = job["velocity"].shape[0]
        self.position, self.experiment = runs // n_exp, runs % n_exp
        for data, place in zip(self.data, self.position, strict=True):
            data.qpos[:] = job["qpos"][place]
        self.axes, nv = len(job["gear"]), self.model.nv
        # One product gives motor angles and deflections, its transpose takes torques to the coordinates.
        self.out, self.into = job["directions"], np.ascontiguousarray(job["directions"].T)
        self.state = np.empty((2, len(runs), nv))
        self.views = [[d.qpos for d in self.data], [d.qvel for d in self.data]]
        self.applied = [d.qfrc_applied for d in self.data]
        self.ripple, self.resolver = Ripple(job["torque_ripple"]), Ripple(job["resolver_ripple"])
        self.springs, self.rubbing = Springs(job), Rubbing(job["rubbing"])
        self.resolution = job["resolution"]
        self.substeps = int(job["substeps"])
        self.step = 1.0 / (float(job["fs"]) * self.substeps)
        torque = job["torque"][self.position]
        self._look()
        self.rest = self.state[0] @ self.out[:, : self.axes]
        self.controller, self.actuators = Cascade(job, self._measured(), torque), Actuators(job, torque)
        self.noise = [np.random.default_rng([int(job["seed"]), p, e]) for p, e in zip(*self._numbers(), strict=True)]

    def _numbers(self):
        return self.position.tolist(), self.experiment.tolist()

    def _look(self):
        for views, rows in zip(self.views, self.state, strict=True):
            np.concatenate(views, out=rows.reshape(-1))

    def _measured(self):
        angle = self.state[0] @ self.out[:, : self.axes]
        if self.resolver.acts:
            angle += self.resolver(angle)
        if self.resolution.any():
            safe = np.where(self.resolution > 0, self.resolution, 1.0)
            angle = np.where(self.resolution > 0, np.round(angle / safe) * safe, angle)
        return angle

    def play(self):
        """Commands and readings of all samples after the run-in, (run, time, axis); yields after every segment."""
        job, first = self.job, int(self.job["run_in"])
        total = job["velocity"].shape[1]
        kept = (len(self.runs), total - first, self.axes)
        self.u, self.y = np.empty(kept), np.empty(kept)
        for start in range(0, total, SEGMENT):
            span = slice(start, min(start + SEGMENT, total))
            count = span.stop - start
            velocity, position = (
                np.ascontiguousarray(job[name][self.experiment, span].swapaxes(0, 1))
                for name in ("velocity", "position")
            )
            position += self.rest
            noise = np.stack([rng.standard_normal((count, self.axes)) for rng in self.noise], axis=1)
            noise *= float(job["noise"])
            u, y = self._segment(velocity, position, noise)
            self._check(y, position, start)
            later = max(first - start, 0)
            if later < count:
                place = slice(start + later - first, span.stop - first)
                self.u[:, place], self.y[:, place] = u[later:].swapaxes(0, 1), y[later:].swapaxes(0, 1)
            yield count / total

    def _segment(self, velocity, position, noise):
        u, y = np.empty_like(velocity), np.empty_like(velocity)
        for k in range(len(velocity)):
            self._look()
            reading = y[k] = self._measured() + noise[k]
            u[k] = self.controller(reading, position[k], velocity[k])
            for torque in self.actuators(u[k]):
                self._move(torque)
        return u, y

    def _move(self, torque):
        """One substep. What MuJoCo does not have acts as in the middle of the step, extrapolated from its start."""
        self._look()
        place, speed = self.state @ self.out
        middle = place + 0.5 * self.step * speed
        axes = self.axes
        pull = self.springs(middle[:, axes:], speed[:, axes:])
        net = torque
        if self.ripple.acts:
            net = net + self.ripple(middle[:, :axes])
        if self.rubbing.rows:
            net = net - self.rubbing(speed[:, :axes], self._load(middle, speed, pull, torque))
        force = np.concatenate([net, -pull], axis=1) @ self.into
        model, step = self.model, mujoco.mj_step
        for data, applied, row in zip(self.data, self.applied, force, strict=True):
            applied[:] = row
            step(model, data)

    def _load(self, middle, speed, pull, torque):
        """Gear torque on the motor side; the motor's own where the transmission is rigid."""
        load = torque.copy()
        spring = middle[:, self.axes :] * self.springs.stiffness + speed[:, self.axes :] * self.springs.damping + pull
        for i, axis in enumerate(self.job["spring_axis"]):
            if axis >= 0:
                load[:, axis] = spring[:, i] / self.job["gear"][axis]
        return load

    def _check(self, y, position, start):
        gone = ~(np.abs(y - position) <= ASTRAY * np.abs(self.job["gear"])).all(axis=2)
        if gone.any():
            when, run = np.argwhere(gone)[0]
            place, experiment = (int(x[run]) for x in (self.position, self.experiment))
            seconds = (start + when) / float(self.job["fs"])
            raise SystemExit(f"position {place}, experiment {experiment} leaves its reference at {seconds:.3g} s")


def main(job_file, first, last, result):
    with np.load(job_file) as file:
        job = {name: file[name] for name in file.files}
    numbers, chunk = np.arange(int(first), int(last)), int(job["chunk"])
    u, y, done = [], [], 0.0
    for start in range(0, len(numbers), chunk):
        runs = Runs(job, numbers[start : start + chunk])
        for part in runs.play():
            done += part * len(runs.runs) / len(numbers)
            print(f"{done:.6f}", flush=True)
        u.append(runs.u)
        y.append(runs.y)
    np.savez(result, u=np.concatenate(u), y=np.concatenate(y))


if __name__ == "__main__":
    main(*sys.argv[1:])
