"""Small networks learn fastest on one thread, above all where others use the machine too."""

import torch

torch.set_num_threads(1)
