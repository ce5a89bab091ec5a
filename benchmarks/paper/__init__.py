"""The paper's figures and claims, measured by `fbl-gym reproduce`.

    leakage.py     section 2: figures 2 and 3, equations (5), (6), (44) and (45)
    robust.py      section 3: figure 4, equation (10)
    adaptive.py    section 4: figures 6 to 10, equations (43) and (46)
    radius.py      sections 3 and 4: the uncertainty radius of the controllers
    claim.py       the record of a claim, and helpers of all the above
    claims.py      all claims by name, in files

Each public function of the first four files measures one claim: it takes an `Effort`, and returns
a `Claim` and a function that draws the claim's figure.
"""
