"""The paper's figures and claims, measured by `fbl-gym reproduce`.

    section_2.py   figures 2 and 3, equations (5) and (6)
    section_3.py   figure 4, equations (10) and (19) to (21), radius of the robust design
    section_4.py   figures 5 to 10, equations (22) and (43) to (46), radius of the adaptive design
    leakage.py     the leakage of a wrong model
    radius.py      the share of seeds that track, against the uncertainty radius
    claim.py       the record of a claim, and helpers of all the above
    claims.py      all claims by name, in files

Each function that is decorated with `claim` measures one claim: it takes an `Effort` and returns a
`Finding`.
"""
