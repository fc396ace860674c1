"""The probabilities of a group: contexts and their mixing. All numbers are integers; `>>` rounds down."""

import math
from pathlib import Path

from .layout import N_CONTEXTS, N_MIXERS

PRIOR = Path(__file__).parents[4] / "codec/src/dense/prior.bin"
MAX_LOGIT = 2047

# A context moves by 1/(n + 1.6) of its error at its n-th bit, and by at least 2 %.
MOVES = [max(65536 * 5 // (5 * n + 8), 1311) for n in range(64)]
FIRST_RATE, LAST_RATE = 1311, 393

KNOTS = [math.floor(65536 / (1 + math.exp(8 - i / 8)) + 0.5) for i in range(129)]


def squashed(logit):
    """The probability in 2^-16 of a logit in 1/256: linear between the knots."""
    knot, rest = divmod(logit + 2048, 32)
    return (KNOTS[knot] * (32 - rest) + KNOTS[knot + 1] * rest + 16) >> 5


# Starting at -MAX_LOGIT.
PROBABILITIES = [squashed(logit) for logit in range(-MAX_LOGIT, MAX_LOGIT + 1)]


def _logits():
    """By probability / 16: the smallest logit whose probability is at least the middle of the interval."""
    logit, logits = -MAX_LOGIT, []
    for i in range(4096):
        while logit < MAX_LOGIT and squashed(logit) < 16 * i + 8:
            logit += 1
        logits.append(logit)
    return logits


LOGITS = _logits()


class Model:
    def __init__(self, prior=PRIOR):
        self.prior = prior.read_bytes()
        if len(self.prior) != 3 * N_CONTEXTS + 6 * N_MIXERS:
            raise ValueError(f"{prior} has {len(self.prior)} bytes, which is not its size")
        self.reset()

    def reset(self):
        contexts = self.prior[: 3 * N_CONTEXTS]
        self.probabilities = [low | high << 8 for low, high in zip(contexts[::3], contexts[1::3])]
        self.seen = list(contexts[2::3])
        self.weights, self.mixed_bits = [], [0] * N_MIXERS
        for i in range(N_MIXERS):
            at = 3 * N_CONTEXTS + 6 * i
            words = (self.prior[at + 2 * k : at + 2 * k + 2] for k in range(3))
            self.weights.append([int.from_bytes(w, "little", signed=True) << 6 for w in words])

    def mixed(self, coder, contexts, mixer):
        """Decodes a bit with the mixed probability of two or three contexts."""
        weights, probabilities = self.weights[mixer], self.probabilities
        logits = [LOGITS[probabilities[context] >> 4] for context in contexts]
        total = 0
        for logit, weight in zip(logits, weights):
            total += logit * weight
        logit = total >> 16
        logit = MAX_LOGIT if logit > MAX_LOGIT else -MAX_LOGIT if logit < -MAX_LOGIT else logit
        probability = PROBABILITIES[logit + MAX_LOGIT]
        probability = 24 if probability < 24 else 65512 if probability > 65512 else probability
        bit = coder.split(65536 - probability)
        error = 65536 - probability if bit else -probability
        rate = FIRST_RATE * 16 // (16 + self.mixed_bits[mixer])
        rate = max(rate, LAST_RATE)
        for i, logit in enumerate(logits):
            weights[i] += ((error * logit >> 8) * rate + 32768) >> 16
        if self.mixed_bits[mixer] < 1024:
            self.mixed_bits[mixer] += 1
        for context in contexts:
            self.learn(context, bit)
        return bit

    def single(self, coder, context):
        """Decodes a bit with one context."""
        bit = coder.split(65536 - min(max(self.probabilities[context], 32), 65504))
        self.learn(context, bit)
        return bit

    def learn(self, context, bit):
        seen = self.seen[context]
        error = (65535 if bit else 0) - self.probabilities[context]
        self.probabilities[context] += error * MOVES[seen] >> 16
        if seen < 63:
            self.seen[context] = seen + 1
