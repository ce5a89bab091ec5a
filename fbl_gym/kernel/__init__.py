"""One control step of an arm or a batch: the only place where time advances.

The kernel works on a batch in blocks of `LANES` lanes. Within a block each phase is a loop over
lanes without branches, which the compiler turns into vector instructions. A lane's arithmetic is
the same in every batch: lane i of any batch is bit for bit the single environment.
`memory/layout.py` names the numbers that the kernel reads and writes. The functions share these
arguments:

    settings    the scenario's, a record of the type `SETTINGS`
    tables      arrays that the scenario contains, one after the other
    block       a record of the type `BLOCK`
    rows        the same memory as an array [rows x LANES]
    queue       last torque commands of the block [depth x (both joints, its own delay) x lane]
    waypoints   way-points, levels or phases of its reference [points x joint x lane]
    width       number of lanes that are computed
    lane        number of a lane within the block
"""
