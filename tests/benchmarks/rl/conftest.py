"""One thread for torch: small networks learn fastest so, above all on a shared machine."""

import importlib.util

if importlib.util.find_spec("torch") is None:  # without the extra `rl`
    collect_ignore_glob = ["test_*.py"]
else:
    import torch

    torch.set_num_threads(1)
