//! Written by `benches/subject/learn.py` from the shapes mavg and favg: change it there.

use super::model::{Model, Part, Span};

pub(super) const HEAD: Model = Model {
    sigma: 0.0072,
    spans: &[Span {
        part: Part::Head,
        first: 0,
        weights: &[1.25060, -0.03075, -0.08976, -0.07336, -0.03752, -0.00950, -0.00971],
    }],
};

pub(super) const THROAT: Model = Model {
    sigma: 0.0241,
    spans: &[
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.02028, -0.01909, 1.03214, 0.00818, 0.00526, -0.00547, -0.02714, -0.03649,
                -0.03047, -0.01262,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.01522, 0.01195, 0.00897, 0.00512, 0.00702, 0.00471],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[0.01522, 0.01195, 0.00897, 0.00512, 0.00702, 0.00471],
        },
    ],
};

pub(super) const SHOULDER: Model = Model {
    sigma: 0.0094,
    spans: &[
        Span {
            part: Part::Arm,
            first: 10,
            weights: &[
                -0.02718, -0.01797, -0.00984, -0.00131, 0.00569, 0.00572, 1.06584, -0.00296,
                -0.00366, -0.00452, -0.00455, -0.01261,
            ],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.01198, -0.00906, -0.00635, -0.00102, 0.00547, -0.00512],
        },
        Span {
            part: Part::Leg,
            first: 23,
            weights: &[-0.00513, -0.00078, 0.00935, 0.02258, 0.00283],
        },
        Span {
            part: Part::OtherLeg,
            first: 23,
            weights: &[-0.00674, -0.00925, -0.00172, 0.00605, 0.00262],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.00377, 0.00248, 0.01254, 0.01639, 0.01715, 0.01526, 0.00106, -0.00746, -0.01584,
                -0.02221,
            ],
        },
    ],
};

pub(super) const ELBOW: Model = Model {
    sigma: 0.0084,
    spans: &[Span {
        part: Part::Arm,
        first: 5,
        weights: &[
            -0.04102, -0.03041, -0.01873, -0.00849, 0.00033, 1.19731, -0.00369, -0.01076, -0.01350,
            -0.02404, -0.04700,
        ],
    }],
};

pub(super) const WRIST: Model = Model {
    sigma: 0.0047,
    spans: &[Span {
        part: Part::Arm,
        first: 0,
        weights: &[
            0.03452, -0.02672, -0.03187, 1.10257, 0.01291, -0.00508, -0.02300, -0.02812, -0.03521,
        ],
    }],
};

pub(super) const HIP: Model = Model {
    sigma: 0.0161,
    spans: &[
        Span {
            part: Part::Leg,
            first: 16,
            weights: &[
                -0.06067, -0.00660, 0.05156, 0.03277, 0.81188, -0.02887, -0.06053, -0.04839,
                -0.01764, 0.00938, 0.03019, -0.05037,
            ],
        },
        Span {
            part: Part::OtherLeg,
            first: 16,
            weights: &[
                -0.03096, -0.00839, 0.02355, 0.06333, 0.05012, 0.03870, 0.02053, 0.00365, 0.00203,
                0.02669, 0.03742, 0.00663,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.06655, 0.05725, 0.04722, 0.02232, 0.01409, -0.01151],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.08320, -0.05997, -0.04055, -0.01864, 0.00995, -0.02462],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.08208, -0.04294, 0.01192, 0.02927, 0.03031, 0.02497, 0.01789, 0.03209, 0.03498,
                0.06869,
            ],
        },
    ],
};

pub(super) const KNEE: Model = Model {
    sigma: 0.0087,
    spans: &[Span {
        part: Part::Leg,
        first: 8,
        weights: &[
            -0.01883, -0.01541, -0.00805, -0.00389, 1.09146, 0.00444, 0.00437, -0.00365, -0.01409,
            -0.03635,
        ],
    }],
};

pub(super) const ANKLE: Model = Model {
    sigma: 0.0049,
    spans: &[Span {
        part: Part::Leg,
        first: 0,
        weights: &[
            0.07015, -0.03950, -0.00153, 0.00720, 0.00733, 0.94491, 0.00938, 0.00124, -0.00613,
            0.00695,
        ],
    }],
};
