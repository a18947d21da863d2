"""The tasks of learning: a task draws batches, asks the network, and validates it; `snake_training.train` has the one loop.

A task has `settings` (a `LoopSettings`), `network_config` and
network()               the network to start from
batch(first, number)    samples first .. first + number - 1, each of its own seed, as tensors on the CPU
ready(batch)            the batch on its device, with what a teacher says of it
answer(model, batch, autocast)   occupancy and saliency, both (B, 2, K + Q), for `losses.losses_of`
validate(network, device, autocast)   figures by name, or nothing
score(figures)          how good they are
"""
