"""Files of external policies whose factory is missing or misspelt."""

import pytest

from benchmarks.policies import external
from benchmarks.policies.name import PolicyName


def test_a_file_without_a_factory_suggests_its_class_and_no_imported_name(tmp_path):
    law = tmp_path / "law.py"
    law.write_text(
        "from dataclasses import dataclass\nfrom controllers import TorqueLaw\n\n\n"
        "def helper():\n    pass\n\n\n@dataclass(frozen=True)\nclass MyLaw(TorqueLaw):\n    pass\n"
    )
    with pytest.raises(external.NotFound) as problem:
        external.load(PolicyName.parse(str(law)))
    assert str(problem.value) == f"{law} has no make_policy: add `make_policy = MyLaw`, or give {law}:MyLaw"
    with pytest.raises(external.NotFound, match=r"'MyLow'; did you mean 'MyLaw'\? Known: MyLaw$"):
        external.load(PolicyName.parse(f"{law}:MyLow"))
    assert external.load(PolicyName.parse(f"{law}:MyLaw")).__name__ == "MyLaw"
    law.write_text("from controllers.simple import Zero\n")
    with pytest.raises(external.NotFound, match=r"unknown factory of .*law\.py 'make_policy'\. Known: none"):
        external.load(PolicyName.parse(str(law)))
