"""The command `fbl-gym show`: a scenario with every number, and what follows from them."""

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.report import terminal
from benchmarks.run.rollout import reference_motion
from benchmarks.studies.recommend import likeness
from benchmarks.text import say
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import Array, inertia_matrix, inverse_dynamics
from fbl_gym.options.link import straight_chain
from fbl_gym.records.record import Distribution, declarations, ends, middle

#: Slower vibrations of a link [Hz] are taken for a mistake of units.
SLOWEST = 0.5

#: The seeds whose references the torque of the motion is taken from.
SEEDS = range(32)


def run(arguments: argparse.Namespace) -> int:
    """Print the options of a scenario, or the differences of two, and what follows from them."""
    tasks = [scenarios.get(name) for name in (arguments.scenario, arguments.other) if name is not None]
    for title, describe in (("option", lambda task: dict(options(task))), ("what follows", follows)):
        columns = [describe(task) for task in tasks]
        names = dict.fromkeys(name for column in columns for name in column)
        rows = [[name, *(column.get(name, "–") for column in columns)] for name in names]
        if title == "option" and arguments.other:
            rows = [row for row in rows if len({*row[1:]}) > 1]
        terminal.show("", [title, *(task.name for task in tasks)], rows, "left")
    for task in tasks:
        for doubt in doubts(task):
            say(f"{task.name}: {doubt}", sys.stderr)
    return 0


def doubts(scenario: Scenario) -> Iterator[str]:
    """Yield sentences on what the arm cannot do, or what looks like a mistake of units."""
    if scenario.actuator.torque_limit is not None:
        share = _share(scenario, *reference_motion(scenario, SEEDS))
        if share[np.array(scenario.actuator.torque_limit) > 0].max(initial=0.0) > 100.0:
            yield f"its motion needs {_both(share, '% of actuator.torque_limit')}, which is in N m"
    if scenario.joint is not None:
        stiffness, _ = scenario.joint.springs(scenario.arm, middle)
        rate, _ = _modes(inertia_matrix(scenario.arm.lumped, (0.0, 0.0)), stiffness)
        if rate < SLOWEST:
            yield f"its links vibrate at {rate:.3g} Hz; joint.stiffness is in N m/rad, joint.frequency in Hz"


def _modes(inertia: Array, stiffness: Array) -> Array:
    """Return the rates at which two masses on springs vibrate, [2] Hz."""
    rates = np.linalg.eigvals(np.linalg.solve(inertia, np.diag(stiffness)))
    return np.sort(np.sqrt(rates.real)) / (2 * np.pi)


def options(record: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path with the unit, and the value in words, of each option that is on."""
    for name, declaration in declarations(type(record)).items():  # type: ignore[arg-type]
        value = getattr(record, name)
        if name in ("name", "description", "kind") or value is None:
            continue
        if dataclasses.is_dataclass(value) and not isinstance(value, Distribution):
            yield from options(value, f"{path}{name}.")
        elif name == "events":
            for i, event in enumerate(value):
                yield from options(event, f"events[{i}]: {event.kind}, ")
        else:
            yield path + name + (f" [{declaration.unit}]" if declaration.unit else ""), _words(value)


def _words(value: Any) -> str:
    """Return a value in words; both joints' once where they are equal."""
    if isinstance(value, Distribution):
        kind = next(kind for kind, numbers in vars(value).items() if numbers is not None)
        numbers = [f"{x:.4g}" for x in value.values]
        if kind == "choice":
            return "one of " + ", ".join(numbers)
        return numbers[0] if numbers[0] == numbers[-1] else f"{' to '.join(numbers)}, {kind.replace('_', '-')}"
    if isinstance(value, tuple):
        words = value[:1] if len(value) == 2 and value[0] == value[1] else value
        return "; ".join(map(_words, words)) if len(value) < 9 else f"{len(value)} values"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def follows(scenario: Scenario) -> dict[str, str]:
    """Return what follows from a scenario's numbers, in words; distributions count by their middle.

    The dead time is from a motion to the torque that answers it: half a sample in which the torque
    is held, half of the interval over which the velocity is computed, age of the readings,
    computation, delay and lag.
    """
    arm, drive, encoder, joint = scenario.arm, scenario.actuator, scenario.encoder, scenario.joint
    _, p2, _, p4, p5 = arm.lumped
    stretched = inertia_matrix(arm.lumped, (0.0, 0.0))
    weight = np.array([abs(p4) + abs(p5), abs(p5)])
    samples = 0.5 + middle(drive.delay_samples)
    samples += 0.0 if encoder is None else encoder.latency + 0.5 * (encoder.difference or 0)
    dead = samples * scenario.control_dt + middle(drive.delay) + 0.5 * ends(drive.jitter)[1] + middle(drive.lag)
    delays = dict.fromkeys(f"{1e3 * delay:.3g}" for delay in drive.facts(scenario)["delay"])
    facts = {
        "class of robots, of @tuned": scenario.robot_class,
        "most like": likeness(scenario)[1].removeprefix("class: "),
        "weight (largest torque of gravity)": _both(weight, "N m"),
        "inertia of the stretched links": _both(np.array([stretched[0, 0], p2]), "kg m^2"),
        "delay of a command: delay, delay_samples, jitter": f"{' to '.join(delays)} ms",
        "dead time": f"{1e3 * dead:.3g} ms",
    }
    if joint is not None:
        stiffness, rates = joint.springs(arm, middle)
        facts["stiffness of the joints"] = _both(stiffness, "N m/rad")
        facts["frequency of each stretched joint alone, motor held"] = _both(rates, "Hz")
        facts["modes of the stretched links, motors held"] = _both(_modes(stretched, stiffness), "Hz")
    if scenario.link is not None:
        chain = straight_chain(arm, 0.0)[0][2:, 2:]
        stiffness, _ = scenario.link.springs(arm, 2 * np.pi * np.array([*map(middle, scenario.link.frequency)]))  # type: ignore[arg-type]
        facts["modes of the links, joints held"] = _both(_modes(chain, stiffness), "Hz")
    if drive.torque_limit is not None:
        limit = np.array(drive.torque_limit)
        q, v, a = reference_motion(scenario, SEEDS)
        if weight.min() > 0.0:
            facts["torque limit / weight"] = _both(limit / weight, "")
        if scenario.friction is not None:
            dry = np.array([ends(coulomb)[1] for coulomb in scenario.friction.coulomb])  # type: ignore[union-attr]
            facts["largest Coulomb friction"] = _both(_percent(dry, limit), "% of the limit")
        facts["largest torque of the nominal motion"] = _both(_share(scenario, q, v, a), "% of the limit")
        facts["its largest velocity"] = _both(np.abs(v).max(axis=(0, 1)), "rad/s")
    return facts


def _share(scenario: Scenario, q: Array, v: Array, a: Array) -> Array:
    """Return the largest torque of a motion in % of the drives' limit, [2].

    It is that of the nominal arm, with the friction's middle.
    """
    torque = inverse_dynamics(dataclasses.replace(scenario.arm, rotor=scenario.rotor), q, v, a)
    if friction := scenario.friction:
        viscous, dry, load = (np.array([*map(middle, x)]) for x in (friction.viscous, friction.coulomb, friction.load))  # type: ignore[arg-type]
        torque = torque + viscous * v + (dry + load * np.abs(torque)) * np.sign(v)
    return _percent(np.abs(torque).max(axis=(0, 1)), np.array(scenario.actuator.torque_limit))


def _percent(torque: Array, limit: Array) -> Array:
    """Return torques in % of the drives' limit; infinite where that is 0, [2]."""
    return np.divide(100 * torque, limit, out=np.full(2, np.inf), where=limit > 0)


def _both(numbers: Array, unit: str) -> str:
    return f"{', '.join(f'{x:.3g}' if x < np.inf else 'no drive' for x in numbers)} {unit}".rstrip()
