"""The built-in laws, in the order of every list. Their modules are imported on first use."""

LAWS = (
    # name, module, summary; the class has the name of the law
    ("zero", "laws.simple", "no torque at all"),
    ("pd-gravity", "laws.simple", "PD with the nominal gravity torque"),
    # the paper's controllers
    ("pid-flm", "paper.pid", "the paper's PID through nominal feedback linearisation (§2.2)"),
    ("cascade-flm", "paper.cascade", "the paper's cascade: inner velocity PI, outer P with feed-forward (§3.1)"),
    ("robust-flm", "paper.kalman", "the paper's robust controller: the cascade behind a Kalman filter (§3)"),
    ("adaptive-flm", "paper.adaptive", "the paper's adaptive controller: three-sample estimator, cascade (§4)"),
    ("adaptive-flm-scheduled", "paper.adaptive", "adaptive-flm with the paper's gain schedule (§4.2)"),
    ("adaptive-robust-flm", "paper.adaptive", "estimator, schedule, cascade and Kalman filter (§3 and §4)"),
    # comparators
    ("computed-torque-eso", "laws.adrc", "computed torque on an extended state observer, position alone"),
    ("ladrc", "laws.adrc", "linear active disturbance rejection: no model but the diagonal of the inertia (Gao)"),
    ("lqg", "laws.lqg", "optimal regulator with integral action on a Kalman filter"),
    ("lqg-elastic", "laws.lqg_elastic", "LQG on links, springs, drive and disturbance, position alone"),
    ("lqg-elastic-scheduled", "laws.lqg_elastic", "a careful and a fast lqg-elastic, mixed by a hand-written rule"),
    ("h-infinity", "laws.h_infinity", "H-infinity loop shaping, position alone (McFarlane, Glover)"),
    ("rbf-adaptive", "laws.rbf_adaptive", "neural adaptive control with radial basis functions (Lewis)"),
    ("pid-gravity", "laws.simple", "PID with the nominal gravity torque"),
    ("computed-torque", "laws.computed_torque", "plain computed torque, critically damped"),
    ("computed-torque-dob", "laws.computed_torque", "computed torque with a momentum observer"),
    ("computed-torque-tde", "laws.computed_torque", "computed torque with time-delay estimation"),
    ("l1-adaptive", "laws.l1_adaptive", "L1 adaptive control on the nominal linearisation (Hovakimyan, Cao)"),
    ("computed-torque-gp", "laws.gaussian_process", "computed torque and an online Gaussian process"),
    ("computed-torque-ilc", "laws.iterative_learning", "computed torque that learns over repeated trials"),
    ("computed-torque-adaptive", "laws.adaptive_computed_torque", "adaptive computed torque (Craig)"),
    ("slotine-li", "laws.passivity", "adaptive passivity-based control of the lumped parameters"),
    ("slotine-li-composite", "laws.passivity", "slotine-li, driven by the prediction error too"),
    ("sliding-mode", "laws.sliding_mode", "super-twisting on the nominal linearisation (Levant)"),
    ("terminal-sliding-mode", "laws.sliding_mode", "nonsingular terminal sliding mode and observer (Feng)"),
    ("spong-robust", "laws.passivity", "Spong's robust law with a bound for each parameter"),
    ("swing-up", "laws.swing_up", "swing-up of an arm that lacks a drive: energy shaping, then LQR (Spong)"),
    ("oracle-flm", "oracles.oracle", "feedback linearisation with the true arm, state and loads"),
    ("oracle-elastic", "oracles.oracle", "optimal regulator on the true arm, springs and drives included"),
    ("oracle-planned", "oracles.planned", "oracle-elastic along the feasible motion closest to the reference"),
)

ACCESS = {"zero": "none", **{name: "oracle" for name, _, _ in LAWS if name.startswith("oracle")}}
"""What a law may know; all others know the nominal model."""
