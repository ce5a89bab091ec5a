"""The paper's figures and claims, measured by `fbl-gym reproduce`.

    section_2.py   figures 2 and 3, equations (5), (6) and (45)
    section_3.py   figure 4, equations (10) and (19) to (21), radius of the robust design
    section_4.py   figures 5 to 10, equations (22) and (36) to (46), radius of the adaptive design
    measuring.py   runs on the paper's arms, and the share of seeds that track within a radius
    claim.py       the record of a claim, its cases, and the rule of its verdicts
    claims.py      all claims by name, in files

`claim` declares one: the values that the paper states, those that it leaves open, and its cases,
each with the values that it changes. The decorated function measures one case.
"""
