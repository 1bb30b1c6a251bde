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
# Springs behind dampers and behind sliders, as `jaxfrf.effects` states structural damping and hysteresis of gears.
CORNERS, WEIGHTS = np.array([3.0, 17.3, 100.0]), np.array([1.5, 1.0, 1.5])  # Hz; stiffness over loss k
SOFTER = float(np.sum(WEIGHTS / (1.0 + (CORNERS / 20.0) ** 2)))  # at rest, over loss k: the whole is k stiff at 20 Hz
YIELDS = np.array([0.25, 0.75, 1.25, 1.75])  # of the mean deflection at which they slip


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
        self.kp, self.kv, self.limit = job["position_gain"], job["velocity_gain"], job["torque_limit"]
        self.feedforward, self.fs = bool(job["feedforward"]), float(job["fs"])
        self.rate = 1.0 / (self.fs * job["integral_time"])
        self.new = 1.0 - np.exp(-2 * np.pi * job["speed_filter"] / self.fs)  # 1 without a filter
        self.speed, self.waits = np.zeros_like(reading), bool(job["anti_windup"])
        held = (self.kv > 0) & (self.rate > 0)
        self.integral = np.where(held, torque / np.where(held, self.kv, 1.0), 0.0)
        self.last = reading

    def __call__(self, reading, position, velocity):
        error = self.kp * (position - reading)
        self.speed += self.new * (self.fs * (reading - self.last) - self.speed)
        error -= self.speed
        if self.feedforward:
            error += velocity
        grown = self.integral + self.rate * error
        self.last = reading
        wanted = self.kv * (error + grown)
        stuck = self.waits & (np.abs(wanted) > self.limit) & (wanted * error > 0)
        self.integral = np.where(stuck, self.integral, grown)
        return np.clip(wanted, -self.limit, self.limit)


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


class Gears:
    """What transmissions pull beyond their linear springs, arm side, N m, and what the motors feel of uneven ones."""

    def __init__(self, job, x, place):
        self.springs = Springs(job)
        axis = job["spring_axis"]
        self.axis, self.gear = axis, np.where(axis >= 0, job["gear"][np.maximum(axis, 0)], np.inf)
        count = len(axis)
        self.lead = [(int(row[0]), *row[1:]) for row in job["gear_lead"]]
        self.loss, self.torque, self.slip = np.zeros(count), np.zeros(count), np.ones(count)
        for spring, value in job["gear_loss"]:
            self.loss[int(spring)] += value
        for spring, torque, slip in job["gear_slip"]:
            self.torque[int(spring)], self.slip[int(spring)] = torque, slip
        self.yields = np.multiply.outer(YIELDS, self.slip)[:, None]
        self.x = x + self._turned(place)[0]
        self.tension = self._tension(self.x)
        self.relaxing, self.sliding = np.zeros((3, *x.shape)), np.zeros((4, *x.shape))

    def __call__(self, x, rate, place, speed, step):
        """(torque beyond stiffness x + damping rate, torque against the motors); `place`, `speed`: of all motors."""
        springs = self.springs
        if not (self.lead or self.loss.any() or self.torque.any()):
            return springs(x, rate), None
        lead, slope = self._turned(place)
        more = slope * speed[:, self.axis] / self.gear
        bent = x + lead
        pull = springs(bent, rate + more) + springs.stiffness * lead + springs.damping * more
        pull += self._lost(bent, step) + self._slipped(bent)
        self.x = bent
        whole = pull + springs.stiffness * x + springs.damping * rate
        return pull, slope * whole / self.gear

    def _turned(self, place):
        """Lead of the gears' outputs, and its derivative by the motors' angles on the arm side."""
        lead, slope = np.zeros((2, len(place), len(self.axis)))
        for spring, amplitude, order, phase in self.lead:
            turned = order * place[:, self.axis[spring]] / self.gear[spring] + phase
            lead[:, spring] += amplitude * np.sin(turned)
            slope[:, spring] += amplitude * order * np.cos(turned)
        return lead, slope

    def _tension(self, x):
        return self.springs.stiffness * x + self.springs(x, np.zeros_like(x))

    def _lost(self, x, step):
        """Springs behind dampers; trapezoids."""
        if not self.loss.any():
            return 0.0
        tension, half = self._tension(x), np.pi * CORNERS[:, None, None] * step
        self.relaxing = ((1.0 - half) * self.relaxing + tension - self.tension) / (1.0 + half)
        self.tension = tension
        return self.loss * (np.tensordot(WEIGHTS, self.relaxing, 1) - SOFTER * tension)

    def _slipped(self, x):
        """Springs behind sliders."""
        if not self.torque.any():
            return 0.0
        self.sliding = np.clip(self.sliding + (x - self.x), -self.yields, self.yields)
        return self.torque / self.slip * self.sliding.mean(axis=0)


class Bristles:
    """LuGre friction in rows (axis, level, distance, damping), the exact motion of its bristles at constant speed."""

    def __init__(self, rows, runs: int):
        self.axis, (self.level, self.distance, self.damping) = rows[:, 0].astype(int), rows[:, 1:].T
        self.bent = np.zeros((runs, len(rows)))

    def __call__(self, speed, step):
        v, old = speed[:, self.axis], self.bent
        end = np.sign(v) * self.distance
        self.bent = np.where(v == 0.0, old, end + (old - end) * np.exp(-np.abs(v) * step / self.distance))
        torque = np.zeros_like(speed)
        torque[:, self.axis] = self.level / self.distance * 0.5 * (old + self.bent)
        torque[:, self.axis] += self.damping * (self.bent - old) / step
        return torque


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
        (self.swing, self.begin, self.length), self.fs = job["drift"], float(job["fs"])
        self.plain = np.all(self.gain == 1.0) and np.all(np.isinf(self.limit)) and not self.swing.any()
        self.late = self.weight.shape[1] > 1
        self.samples = 0
        self.past = np.repeat(self._now(torque)[:, None], self.weight.shape[1], axis=1)

    def _now(self, torque):
        if self.plain:
            return torque
        gone = np.clip((self.samples / self.fs - self.begin) / self.length, 0.0, 1.0)
        return np.clip(self.gain * (1.0 + self.swing * (gone - 0.5)) * torque, -self.limit, self.limit)

    def __call__(self, torque):
        """(substep, run, axis)."""
        torque = self._now(torque)
        self.samples += 1
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
        self.rubbing, self.bristles = Rubbing(job["rubbing"]), Bristles(job["bristles"], len(runs))
        self.stops = [(int(row[0]), *row[1:]) for row in job["stops"]]
        self.resolution = job["resolution"]
        self.substeps = int(job["substeps"])
        self.step = 1.0 / (float(job["fs"]) * self.substeps)
        torque = job["torque"][self.position]
        self._look()
        self.rest = self.state[0] @ self.out[:, : self.axes]
        self.gears = Gears(job, self.state[0] @ self.out[:, self.axes :], self.rest)
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
        angle, speed = self.state @ self.out
        middle = angle + 0.5 * self.step * speed
        axes = self.axes
        pull, against = self.gears(middle[:, axes:], speed[:, axes:], middle[:, :axes], speed[:, :axes], self.step)
        net = torque
        if self.ripple.acts:
            net = net + self.ripple(middle[:, :axes])
        if self.rubbing.rows:
            net = net - self.rubbing(speed[:, :axes], self._load(middle, speed, pull, torque))
        if len(self.bristles.axis):
            net = net - self.bristles(speed[:, :axes], self.step)
        if against is not None:
            net = net.copy()
            net[:, self.gears.axis[self.gears.axis >= 0]] -= against[:, self.gears.axis >= 0]
        force = np.concatenate([net, -pull], axis=1) @ self.into
        for place, stop, side, stiffness in self.stops:
            depth = side * (self.state[0, :, place] + 0.5 * self.step * self.state[1, :, place] - stop)
            force[:, place] -= side * stiffness * np.maximum(depth, 0.0)
        model, step = self.model, mujoco.mj_step
        for data, applied, row in zip(self.data, self.applied, force, strict=True):
            applied[:] = row
            step(model, data)

    def _load(self, middle, speed, pull, torque):
        """Gear torque on the motor side; the motor's own where the transmission is rigid."""
        load = torque.copy()
        springs = self.gears.springs
        spring = middle[:, self.axes :] * springs.stiffness + speed[:, self.axes :] * springs.damping + pull
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
