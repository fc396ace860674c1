"""Trains the confidence of a face (`subject/face/data/face-confidence.bin`), a logistic regression on its quality measures.

    MOCAPD_FACES=... cargo run --release -p mocapd-face --features measure --example faces_points confidence > ROWS
    python3 benches/subject/face_confidence.py ROWS subject/face/data/face-confidence.bin

Needs numpy. ROWS are development photographs and drawn faces, each fitted from start positions at several offsets and from
its detected position; no other photograph is read. A face is good if the mean error of its points is below a tenth of the
distance between the outer eye corners. Photographs, including the renders, have the same total weight as all drawn faces.
The fit restarts when its confidence is low, so the rows depend slightly on the previous constants. Train therefore on the
results of the first start alone (`CONFIDENT` of `points/mod.rs` at 0).
The regression uses Newton's method with a normal prior on the weights of the standardised terms. Terms whose weight has the
wrong sign are removed one by one. The script writes the constant, then weight, minimum and maximum of each term, as
doubles. It prints them, and the results of a tenfold cross-validation.
"""

import sys

import numpy as np

BAD_PERCENT = 10
NAMES = ["clear", "eyes", "brows", "nose", "mouth", "outline", "misfit", "strain", "nod", "turn off", "glance off"]
# 1 where a larger value indicates a better face, else -1.
SIGNS = np.array([1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1])
RANGES = np.array([(0, 1), (0, 0.6), (0, 0.3), (0, 0.6), (0, 0.6), (0.2, 1), (0, 0.4), (0, 30), (0, 40), (0, 40), (0, 12)])
PRIOR = 1.0


def logistic(x, good, weight):
    """Constant and weights of the columns of x; the weight is 0 for columns that would have the wrong sign."""
    kept = list(range(x.shape[1]))
    while True:
        mean, sd = x[:, kept].mean(0), x[:, kept].std(0) + 1e-9
        z = np.column_stack([np.ones(len(x)), (x[:, kept] - mean) / sd])
        beta = np.zeros(z.shape[1])
        prior = np.full(len(beta), PRIOR)
        prior[0] = 0
        for _ in range(50):
            p = 1 / (1 + np.exp(-z @ beta))
            gradient = z.T @ (weight * (good - p)) - prior * beta
            hessian = z.T @ (z * (weight * p * (1 - p))[:, None]) + np.diag(prior)
            beta += np.linalg.solve(hessian, gradient)
        wrong = beta[1:] * SIGNS[kept]
        if wrong.min() >= 0:
            full = np.zeros(x.shape[1])
            full[kept] = beta[1:] / sd
            return beta[0] - full[kept] @ mean, full
        kept.pop(int(wrong.argmin()))


def area(sure, good):
    """Area under the ROC curve: the share of pairs of a good and a bad face in the correct order."""
    return np.mean(sure[good][:, None] > sure[~good][None, :])


def main():
    lines = [line.split(",") for line in open(sys.argv[1], encoding="utf-8") if line.count(",") == 2 + len(NAMES)]
    name = np.array([line[0] for line in lines])
    number = np.array([[float(v) for v in line[1:]] for line in lines])
    good = number[:, 1] < BAD_PERCENT
    x = np.clip(number[:, 2:], *RANGES.T)
    drawn = np.array([n.startswith("drawn") for n in name])
    weight = np.where(drawn, (~drawn).sum() / drawn.sum(), 1.0)
    weight *= len(weight) / weight.sum()
    constant, weights = logistic(x, good, weight)
    table = [float(f"{constant:.2f}")]
    print(f"constant {table[0]}")
    for w, (low, high), what in zip(weights, RANGES, NAMES):
        table += [float(f"{w:.3f}"), low, high]
        print(f"{what}: {w:.3f}, {low:.1f} to {high:.1f}")
    np.array(table, "<f8").tofile(sys.argv[2])
    # All starts of a face, and all faces of a photograph, belong to the same fold.
    tenth = {n: i % 10 for i, n in enumerate(sorted(set(name), key=lambda n: (n.startswith("drawn"), n)))}
    tenths = np.array([tenth[n] for n in name])
    sure = np.zeros(len(x))
    for out in range(10):
        c, w = logistic(x[tenths != out], good[tenths != out], weight[tenths != out])
        sure[tenths == out] = 1 / (1 + np.exp(-(c + x[tenths == out] @ w)))
    for what, part in [("all", good | True), ("photographs", ~drawn), ("drawn", drawn)]:
        s, g = sure[part], good[part]
        print(f"{what}: {len(g)} faces, {np.sum(~g)} bad; area {area(s, g):.3f}; below 0.5: "
              f"{100 * np.mean(s[~g] < 0.5):.0f} % of the bad ones, {100 * np.mean(s[g] < 0.5):.0f} % of the good ones")


if __name__ == "__main__":
    main()
