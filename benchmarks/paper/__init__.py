"""The paper's figures and claims, measured by `fbl-gym reproduce`.

    claims.toml    the claims as data: the values that the paper states, those that it leaves open,
                   and the cases of each
    section_2.py   figures 2 and 3, equations (5), (6) and (45)
    section_3.py   figure 4, equations (10) and (19) to (21), radius of the robust design
    section_4.py   figures 5 to 10, equations (22) and (36) to (46), radius of the adaptive design
    measuring.py   runs on the paper's arms, and the share of seeds that track within a radius
    outcome.py     the outcome of a case, and its values and numbers as texts
    claims.py      all claims by name, the rule of their verdicts, and their files

A function of the claim's name, in its section's file, measures one case.
"""
