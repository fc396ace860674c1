//! Written by `benches/subject/learn.py` from the shapes mavg and favg: change it there.

use super::model::{Model, Part, Span};

pub(super) const HEAD: Model = Model {
    sigma: 0.0183,
    spans: &[Span {
        part: Part::Head,
        first: 0,
        weights: &[1.24279, -0.04016, -0.07827, -0.06651, -0.02116, -0.00962, -0.02707],
    }],
};

pub(super) const THROAT: Model = Model {
    sigma: 0.0268,
    spans: &[
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.01257, -0.00520, 0.91826, 0.01056, 0.01072, 0.01380, -0.00274, -0.01206,
                -0.01604, -0.01311,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.01361, 0.01216, 0.01060, 0.00847, 0.00866, 0.00069],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[0.01361, 0.01216, 0.01060, 0.00847, 0.00866, 0.00069],
        },
    ],
};

pub(super) const SHOULDER: Model = Model {
    sigma: 0.0093,
    spans: &[
        Span {
            part: Part::Arm,
            first: 10,
            weights: &[
                -0.02837, -0.01902, -0.01086, -0.00171, 0.00587, 0.00565, 1.06911, -0.00270,
                -0.00306, -0.00285, -0.00298, -0.01113,
            ],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.00953, -0.00784, -0.00591, -0.00153, 0.00296, -0.00784],
        },
        Span {
            part: Part::Leg,
            first: 23,
            weights: &[-0.00368, 0.00006, 0.00835, 0.02197, 0.00706],
        },
        Span {
            part: Part::OtherLeg,
            first: 23,
            weights: &[-0.00956, -0.01116, -0.00179, 0.00649, 0.00213],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.00545, 0.00107, 0.00677, 0.01571, 0.01681, 0.01744, 0.00404, -0.00627, -0.01564,
                -0.02261,
            ],
        },
    ],
};

pub(super) const ELBOW: Model = Model {
    sigma: 0.0086,
    spans: &[Span {
        part: Part::Arm,
        first: 5,
        weights: &[
            -0.03823, -0.02879, -0.01608, -0.00600, 0.00108, 1.18388, -0.00413, -0.01167, -0.01190,
            -0.02196, -0.04620,
        ],
    }],
};

pub(super) const WRIST: Model = Model {
    sigma: 0.0037,
    spans: &[Span {
        part: Part::Arm,
        first: 0,
        weights: &[0.15175, -0.09501, -0.13140, 0.89253, 0.10693, 0.08317, 0.03105, -0.03902],
    }],
};

pub(super) const HIP: Model = Model {
    sigma: 0.0161,
    spans: &[
        Span {
            part: Part::Leg,
            first: 16,
            weights: &[
                -0.05844, -0.00767, 0.04717, 0.02999, 0.79151, -0.02594, -0.05535, -0.04348,
                -0.01332, 0.00856, 0.02613, -0.04202,
            ],
        },
        Span {
            part: Part::OtherLeg,
            first: 16,
            weights: &[
                -0.02908, -0.00737, 0.02220, 0.06107, 0.04914, 0.03715, 0.02101, 0.00509, 0.00226,
                0.02546, 0.03381, 0.00831,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.06813, 0.05903, 0.04963, 0.02610, 0.01309, -0.00860],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.07880, -0.05942, -0.04231, -0.02168, 0.00459, -0.01927],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.08553, -0.04925, -0.00560, 0.03087, 0.03228, 0.02931, 0.02389, 0.03835, 0.03952,
                0.06948,
            ],
        },
    ],
};

pub(super) const KNEE: Model = Model {
    sigma: 0.0081,
    spans: &[Span {
        part: Part::Leg,
        first: 8,
        weights: &[
            -0.01962, -0.01894, -0.00989, -0.00382, 1.10011, 0.00349, 0.00218, -0.00635, -0.01273,
            -0.03443,
        ],
    }],
};

pub(super) const ANKLE: Model = Model {
    sigma: 0.0068,
    spans: &[Span {
        part: Part::Leg,
        first: 0,
        weights: &[
            0.05270, -0.03686, -0.00196, -0.00352, 0.00269, 0.95100, 0.01862, 0.00945, 0.00013,
            0.00775,
        ],
    }],
};

pub(super) const UPPER_ARM: f64 = 0.1451;

pub(super) const FOREARM: f64 = 0.1425;

pub(super) const THIGH: f64 = 0.2361;

pub(super) const SHANK: f64 = 0.2438;
