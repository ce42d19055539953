"""Damage made on purpose: arrays corrupted for training and for protocols, and harm planted in takes.

In: shapes, a random generator, or a good take. Out: masks, displaced or noisy arrays, or the damaged take and the truth
about it. It must not know how damage is found or repaired, or planted truth would be no truth.
"""
