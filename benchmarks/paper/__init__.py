"""The paper's figures and claims, measured: `fbl-gym reproduce`.

`leakage.py` has section 2, `robust.py` section 3, `adaptive.py` section 4 and `radius.py` how far each controller reaches;
`claims.py` lists them all.
"""
