"""The splits of seeds."""

#: The use of each seed. The board is measured on `test`, which tuning and training never touch, and
#: checked on `sealed`.
SPLITS: dict[str, range] = {
    "test": range(0, 10_000),
    "tuning": range(10_000, 20_000),
    "validation": range(20_000, 30_000),
    "sealed": range(30_000, 40_000),
    "training": range(1_000_000, 2**31),
}
