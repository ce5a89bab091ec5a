"""The layout of a batch's memory: one array of 64-bit numbers, which the kernel reads and writes.

    settings | tables | actions | rewards | flags | final observations | block | block | ...

The settings are the same for all lanes. The tables are the arrays that a scenario contains, such as
the samples of a reference. A block is the state of `LANES` lanes: its fields, then the last torque
commands (three rows: both joints, and the command's own delay), the way-points of the reference and
the last actions (pairs of rows, one row a joint), the last readings of the encoder (four rows:
position and velocity), and the events.

The kernel and `batch.py` see the fields through the structured types `SETTINGS` and `BLOCK`:
`block.position[0, lane]` is the position of joint 1.
"""

from __future__ import annotations

import numpy as np

LANES = 16
"""Number of lanes in a block."""

# Kinds, as numbers in the settings. The friction laws are arguments of compiled functions, which
# Numba would compile again for each plain int.
NO_FRICTION, EXACT_FRICTION, LITERAL_FRICTION = np.arange(3)
FRICTION_LAWS = {"exact": EXACT_FRICTION, "literal": LITERAL_FRICTION}
NO_DISTURBANCE, PIECEWISE_CONSTANT, SINE, PULSES, ARRAY = range(5)
DISTURBANCES = {"piecewise-constant": PIECEWISE_CONSTANT, "sine": SINE, "pulses": PULSES, "array": ARRAY}
SAMPLES, MINIMUM_JERK, STEPS, FILTERED_STEPS, HARMONICS = range(5)
REFERENCES = {
    "array": SAMPLES, "minimum-jerk": MINIMUM_JERK, "steps": STEPS, "filtered-steps": FILTERED_STEPS,
    "sine": HARMONICS, "fourier": HARMONICS,
}  # fmt: skip
NORMALIZED, TORQUE, ACCELERATION = range(3)
NO_AUTORESET, NEXT_STEP, SAME_STEP = range(3)

# Kinds of events, in the order of `events.EVENTS`.
PICK_UP, DROP, FRICTION_CHANGE, DRIVE_CHANGE, KNOCK = range(5)

EVENT_ROWS = 3
"""Rows of a block that an event takes: its time [physics steps] and a size per joint."""

# The status of a lane: within an episode, after its end, or about to start the next one.
RUNNING, ENDED, RESTART = 0.0, 1.0, 2.0

# Kinds of distributions.
UNIFORM, LOG_UNIFORM, CHOICE = range(3)

COLUMNS = 14
"""Largest number of columns of an observation, without its preview."""

VARIED = np.dtype(
    [
        # Start
        ("initial_error", np.float64, 2),  # [rad]
        ("initial_velocity", np.float64, 2),  # added to the reference's [rad/s]
        # Payload
        ("payload_mass", np.float64),  # [kg]
        ("payload_pick_up", np.float64),  # [physics steps]
        ("payload_drop", np.float64),  # [physics steps], may be infinite
        ("payload_offset", np.float64),  # from the tip to its centre, along the link [m]
        ("payload_radius", np.float64),  # of gyration about its centre [m]
        # Real / nominal, of each link's centre and inertia and of each rotor's inertia
        ("centre_ratio", np.float64, 2),
        ("inertia_ratio", np.float64, 2),
        ("rotor_ratio", np.float64, 2),
        # Sensors of position [rad], velocity [rad/s] and acceleration [rad/s^2], for each joint
        ("noise_std", np.float64, (3, 2)),
        ("noise_bias", np.float64, (3, 2)),
        ("dropout", np.float64),  # chance that readings begin to be lost at a sample
        # Friction of each joint
        ("viscous", np.float64, 2),  # [N m s]
        ("coulomb", np.float64, 2),  # [N m]
        ("stiction", np.float64, 2),  # [N m]
        ("v_s", np.float64, 2),  # width of the stiction peak [(rad/s)^2]
        ("load_friction", np.float64, 2),  # Coulomb friction for each N m of the drive
        # Elastic joints
        ("stiffness", np.float64, 2),  # [N m/rad]
        ("damping", np.float64, 2),  # [N m s/rad]
        ("backlash", np.float64, 2),  # [rad]
        ("bend_rate", np.float64, 2),  # natural frequency of links that bend [rad/s]
        # Disturbance
        ("disturbance_amplitude", np.float64, 2),  # [N m]
        ("disturbance_rate", np.float64, 2),  # of a sine [rad/s]
        # Actuator
        ("gain", np.float64, 2),  # real / nominal torque
        ("delay", np.float64),  # [physics steps]
        ("delay_samples", np.float64),  # of computation, which a block's delay includes [control steps]
        ("jitter", np.float64),  # longest further delay of a command [physics steps]
        ("lag", np.float64),  # time constant [physics steps]
        ("rate_limit", np.float64, 2),  # [N m / physics step], may be infinite
        ("ripple", np.float64, 2),  # amplitude [N m]
        ("ripple_phase", np.float64, 2),  # [rad]
    ]
)
"""The numbers that may differ between episodes. The settings have their fixed values under the name
`varied`; a block has a row for each, filled when an episode starts."""

SETTINGS = np.dtype(
    [
        # Rates
        ("substeps", np.int64),  # physics steps in a control step
        ("last_step", np.int64),  # the control step that truncates an episode
        ("control_dt", np.float64),  # [s]
        ("physics_dt", np.float64),  # [s]
        ("external_physics", np.bool_),  # another engine moves the arm and gives its acceleration
        # Nominal arm, and the difference of the real one; four parameters: m1, m2, L1, L2
        ("parameters", np.float64, 4),  # [kg], [m]
        ("gravity", np.float64),  # [m/s^2]
        ("centre", np.float64, 2),  # of each link's mass, as a fraction of its length
        ("inertia", np.float64, 2),  # of each link about its centre, as a fraction of m L^2
        ("rotor", np.float64, 2),  # inertia of each joint's rotor, of the nominal model [kg m^2]
        ("real_rotor", np.float64, 2),  # the same of the drives, which a ratio multiplies
        ("ratio", np.float64, 4),  # real / nominal
        ("log_radius", np.float64, 4),  # log(1 + radius) of the ratio that each episode draws
        ("drawn_together", np.bool_),  # one draw for all parameters
        ("in_proportion", np.int64, 2),  # ratios of centre and inertia are of fractions of real lengths and masses
        ("has_payload", np.bool_),
        # Numbers that may vary
        ("varied", np.float64, VARIED.itemsize // 8),  # fixed values, in the order of `VARIED`
        ("draws", np.int64),  # number of them that each episode draws
        ("drawn_per_seed", np.bool_),  # every episode has the draws of its seed's first one
        ("draw_table", np.int64),  # index of the first of them in the tables, `DRAW_SIZE` numbers each
        # Sensors of position, velocity and acceleration, for each joint
        ("quantization", np.float64, (3, 2)),  # step between readings; 0: none
        ("noisy", np.bool_),  # any reading has an error
        ("has_noise", np.int64, 3),  # the sensor's readings have white noise
        ("senses_acceleration", np.bool_),
        ("history", np.int64),  # control steps whose readings are stored; 0: the encoder is ideal
        ("history_row", np.int64),  # row of a block with the first of them
        ("difference", np.int64),  # control steps over which the velocity is computed; 0: it is measured
        ("low_pass", np.float64),  # share of a new velocity in the low-pass filter's output
        ("latency", np.int64),  # of position and velocity [control steps]
        ("dropout_length", np.int64),  # control steps whose readings are lost together; 0: none is lost
        ("friction_law", np.int64),
        ("elastic", np.bool_),
        ("encoder_on_motor", np.bool_),
        ("flexible", np.bool_),  # links bend
        ("beyond", np.float64, 2),  # nominal inertia that turns on the hinges of a straight arm [kg m^2]
        ("bend_damping", np.float64, 2),  # ratio
        # Events
        ("events", np.int64),  # number of them
        ("event_table", np.int64),  # index of the first one's kind in the tables
        ("event_row", np.int64),  # row of a block that holds the first one's time
        # Disturbance
        ("disturbance_kind", np.int64),
        ("disturbance_period", np.float64),  # of a level, a pulse or a sample [physics steps]
        ("disturbance_width", np.float64),  # of a pulse [physics steps]
        ("disturbance_start", np.float64),  # of the first pulse [physics steps]
        ("disturbance_phase", np.float64, 2),  # of a sine [rad]
        ("disturbance_phase_drawn", np.bool_),  # each episode draws its phases
        ("disturbance_table", np.int64),  # index of the first sample in the tables
        ("disturbance_samples", np.int64),
        # Actuator
        ("torque_limit", np.float64, 2),  # [N m], may be infinite
        ("torque_scale", np.float64, 2),  # torques are shares of it: the limit, or 1 without a drive
        ("delay_steps", np.int64),  # the longest delay in control steps, rounded up
        ("torque_varies", np.bool_),  # torque or disturbance may change within a control step
        ("jittered", np.bool_),
        ("rippled", np.bool_),
        ("ripple_order", np.float64, 2),  # periods of the ripple in a turn of the joint
        # Reference
        ("reference_kind", np.int64),
        ("reference_points", np.int64),  # number of way-points, levels, samples or harmonics
        ("reference_table", np.int64),  # index of their first number in the tables; -1: drawn
        ("reference_low", np.float64, 2),  # range of the drawn way-points [rad]
        ("reference_high", np.float64, 2),
        ("reference_middle", np.float64, 2),  # of harmonics [rad]
        ("reference_phases_drawn", np.bool_),  # each episode draws the harmonics' phases
        ("base_rate", np.float64),  # of the first harmonic [rad/s]
        ("move_time", np.float64),  # of a minimum-jerk move [s]
        ("point_time", np.float64),  # from one way-point to the next [s]
        ("bandwidth", np.float64),  # of filtered steps [rad/s]
        # Interface
        ("action_kind", np.int64),
        ("action_limit", np.float64, 2),
        ("preview", np.int64),  # reference samples ahead
        ("observation_size", np.int64),
        ("observed", np.int64),  # columns before the preview
        ("observed_row", np.int64, COLUMNS),  # row of a block that each column shows
        ("observed_bound", np.float64, COLUMNS),
        ("past_actions", np.int64),  # that follow those columns
        ("past_row", np.int64),  # row of a block with the last one
        ("max_position", np.float64),  # limits of an episode [rad]
        ("max_velocity", np.float64),  # [rad/s]
        ("sensor_range", np.float64, 3),  # of position, velocity and acceleration
        ("max_error", np.float64),  # of the position, for less than `error_steps` [rad], may be infinite
        ("error_steps", np.float64),  # [control steps]
        ("constraint_low", np.float64, 2),  # of the position [rad], may be infinite
        ("constraint_high", np.float64, 2),
        ("constraint_velocity", np.float64, 2),  # [rad/s]
        ("violation_ends", np.bool_),  # a violated constraint ends the episode
        # Reward
        ("reward_logarithmic", np.bool_),
        ("reward_scale", np.float64),  # [1/rad]
        ("reward_norm", np.float64),
        ("reward_weights", np.float64, 3),  # of tracking, effort and chatter, which add up to 1
        # Batch: its size, and the index of each part's first number
        ("autoreset", np.int64),
        ("lanes", np.int64),
        ("block_size", np.int64),  # numbers
        ("waypoints", np.int64),  # pairs of rows of a block's way-points
        ("actions", np.int64),  # [lanes x 2]
        ("rewards", np.int64),  # [lanes]
        ("flags", np.int64),  # a byte each: terminated [lanes], truncated [lanes]
        ("final_observations", np.int64),  # [lanes x size] with SAME_STEP, else empty
        ("blocks", np.int64),
    ],
    align=True,
)

_ONE, _PAIR = LANES, (2, LANES)
_TIMES = (3, 2, LANES)  # start, half and end of a physics step

DRAW_SIZE = 7
"""A draw's row, joint, kind, first and second number, and the halves of its stream's key.

The numbers are the ends of a uniform distribution; the lower end and the logarithm of high / low of
a log-uniform one; the index in the tables and the count of a choice's values.
"""

BLOCK = np.dtype(
    [
        # Motion of the real arm
        ("position", np.float64, _PAIR),  # [rad]
        ("velocity", np.float64, _PAIR),  # [rad/s]
        ("acceleration", np.float64, _PAIR),  # [rad/s^2], if a sensor reads it
        # Real arm
        ("lumped", np.float64, (5, LANES)),  # lumped parameters with the payload [kg m^2], [N m]
        ("parameters", np.float64, (4, LANES)),  # m1, m2 [kg], L1, L2 [m]
        ("payload", np.float64, _ONE),  # carried now [kg]
        ("held_payload", np.float64, _ONE),  # the part of it that `payload_drop` releases [kg]
        *[(name, np.float64, (*VARIED[name].shape, LANES)) for name in VARIED.names or ()],
        # Torque
        ("fade", np.float64, (3, LANES)),  # remainder of the lag at the three times of a physics step
        ("action", np.float64, _PAIR),  # the last one, within its limits
        ("command", np.float64, _PAIR),  # torque command [N m]
        ("late", np.float64, _ONE),  # further delay of the last command [physics steps]
        ("age", np.float64, _ONE),  # of the command that the drives follow [control steps]
        ("chatter", np.float64, _ONE),  # change of the command / torque limit, sum of both joints
        ("target", np.float64, _PAIR),  # command after delay and rate limit [N m]
        ("lagged", np.float64, _PAIR),  # command after delay, rate limit and lag [N m]
        ("torque", np.float64, _PAIR),  # applied torque: the same times the gain, and the ripple [N m]
        ("disturbance", np.float64, _PAIR),  # [N m]
        ("disturbance_phase", np.float64, _PAIR),  # of a sine [rad]
        ("tau", np.float64, _TIMES),  # applied torque less disturbance [N m]
        # Elastic joints
        ("motor_position", np.float64, _PAIR),  # [rad]
        ("motor_velocity", np.float64, _PAIR),  # [rad/s]
        ("load", np.float64, _TIMES),  # torque on the links [N m]
        # Links that bend
        ("bend", np.float64, _PAIR),  # angle of the hinges [rad]
        ("bend_velocity", np.float64, _PAIR),  # [rad/s]
        ("segment_inertia", np.float64, (4, LANES)),  # J of `model/chain.py` with the payload [kg m^2]
        ("segment_moment", np.float64, (4, LANES)),  # f likewise [kg m]
        # Sensors and reference
        ("measured", np.float64, (3, 2, LANES)),  # position [rad], velocity [rad/s], acceleration [rad/s^2]
        ("kept", np.float64, (2, 2, LANES)),  # the last readings of position and velocity that were not lost
        ("reference_position", np.float64, _PAIR),  # [rad]
        ("reference_velocity", np.float64, _PAIR),  # [rad/s]
        ("reference_acceleration", np.float64, _PAIR),  # [rad/s^2]
        # Episode
        ("start_position", np.float64, _PAIR),  # [rad]
        ("far", np.float64, _ONE),  # control steps in a row beyond `max_error`
        ("reward", np.float64, _ONE),
        ("cost", np.float64, _ONE),  # 1 if the step ended beyond a constraint, else 0
        ("terminated", np.float64, _ONE),  # 0 or 1
        ("truncated", np.float64, _ONE),  # 0 or 1
        ("status", np.float64, _ONE),  # RUNNING, ENDED or RESTART
        ("seed", np.uint64, _ONE),
        ("episode", np.uint64, _ONE),  # number of the episode with this seed
        ("step", np.uint64, _ONE),  # control steps since the episode's start
    ],
    align=True,
)

INSTANT = np.dtype(
    [
        ("time", np.float64),  # [s]
        ("acceleration", np.float64, 2),  # [rad/s^2]
        ("friction_torque", np.float64, 2),  # [N m]
    ]
)
"""What `api.inspect` computes of a lane at an instant; the rest of the truth is in the blocks."""

SETTINGS_SIZE = SETTINGS.itemsize // 8
BLOCK_SIZE = BLOCK.itemsize // 8
ROWS = BLOCK_SIZE // LANES


def rows(field: str) -> range:
    """Return the rows of a block that a field takes; a row is `LANES` numbers."""
    dtype, offset = BLOCK.fields[field][:2]  # type: ignore[index]
    return range(offset // (8 * LANES), (offset + dtype.itemsize) // (8 * LANES))


FIRST_VARIED = rows(VARIED.names[0])[0]  # type: ignore[index]
"""Row of a block that holds the first of the numbers that may vary."""
