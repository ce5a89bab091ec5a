"""One control interval, for one arm and for a batch: the only place where time advances.

A batch is worked on in blocks of `LANES` lanes. Within a block each phase is a loop over lanes without branches, which the
compiler turns into vector instructions; a lane's arithmetic is the same whatever the batch, so that lane i of any
batch is bit for bit the single environment. `settings.py` says where each number lies.

    torque.py     action -> torque command, within the limit; actuator and disturbance
    physics.py    `substeps` times: payload, friction, Runge-Kutta
    readings.py   acceleration, noise, quantization; the flat observation
    motion.py     the reference
    episode.py    start, reward, divergence
    api.py      what `batch.py` calls: all of it in order, compiled once and kept on disk
"""
