"""The page of the shipped agents' model cards: `python -m benchmarks.rl.cards > docs/agents.md`."""

import inspect

from benchmarks.rl import policy
from benchmarks.rl.agent import describe

_BEYOND = {
    "crossq": ("93 mrad, 0", "123 mrad, 1"),
    "ppo-context": ("2,703 mrad, 28", "518 mrad, 6"),
    "ppo-memory": ("526 mrad, 2", "112 mrad, 1"),
    "ppo-torque": ("2,881 mrad, 30", "789 mrad, 9"),
    "sac": ("622 mrad, 2", "394 mrad, 4"),
    "td3": ("378 mrad, 0", "194 mrad, 2"),
    "tqc": ("219 mrad, 0", "215 mrad, 2"),
}
"""Mean RMS error and number of diverged runs on the test seeds 0 to 31: on everything-2 with a
delay of 10 ms, and with a radius of 2 (masses and lengths off by up to a factor of three)."""

_IDEAL = (
    "not applicable without an accelerometer; on `everything-2` with a delay of 10 ms: {} of 32 runs diverged; "
    "with masses and lengths off by up to a factor of three: {} of 32"
)
_HARDWARE = "more diverged runs than its law alone where torque limits bind, as in `practice-saturation-3`"


def page() -> str:
    """Return the documentation's page of model cards, in Markdown."""
    text = """# Model cards of the shipped agents

What was each agent trained on, with which budget, and where does it fail? The numbers are those of its `agent.json`,
in `benchmarks/rl/agents/NAME/TRAINING_SEED`, which also has all hyperparameters.
The steps are those until the best validation. `NAME` is the agent of the training seed with the smallest validation
error, and on the board the mean over all; `NAME@SEED` is that of one. The command is that of `NAME`.
[Learning agents](rl.md) compares the agents.

All agents are multilayer perceptrons in plain NumPy files, under the MIT licence. They are made for this simulated
arm: none has moved a real one. `python -m benchmarks.rl.cards > docs/agents.md` writes this page.
"""
    for name, seeds in policy.shipped().items():
        text += f"\n## {name}\n\n{inspect.getdoc(getattr(policy, name.replace('-', '_')))}.\n\n"
        all_seeds = {seed: describe(policy.SHIPPED / name / str(seed)) for seed in seeds}
        best = all_seeds[policy.best_seed(name)]
        trained_on = best.get("scenarios") or [best["scenario"]["name"]]
        minutes = [each["wall_s"] / 60 for each in all_seeds.values()]
        rows = {
            "trained on": ", ".join(f"`{scenario}`" for scenario in trained_on),
            "command": f"`{best['command']}`",
            "steps": ", ".join(f"{each['steps']:,} (seed {seed})" for seed, each in all_seeds.items()),
            "minutes": f"{min(minutes):.1f} to {max(minutes):.1f}, {best['machine']}",
            "validation error [mrad]": ", ".join(f"{each['validation_mrad']:.3g}" for each in all_seeds.values()),
            "packages": ", ".join(f"{package} {version}" for package, version in best["packages"].items()),
            "where it fails": _IDEAL.format(*_BEYOND[name]) if name in _BEYOND else _HARDWARE,
        }
        text += "| | |\n|---|---|\n" + "".join(f"| {title} | {value} |\n" for title, value in rows.items())
    return text


if __name__ == "__main__":
    print(page(), end="")
