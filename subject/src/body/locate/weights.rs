//! Written by `benches/subject/learn.py` from the shapes mavg and favg: change it there.

use super::model::{Model, Part, Span};

pub(super) const HEAD: Model = Model {
    sigma: 0.0132,
    spans: &[Span {
        part: Part::Head,
        first: 0,
        weights: &[1.18373, 0.01004, -0.00326, -0.07048, -0.06205, -0.03031, -0.02767],
    }],
};

pub(super) const THROAT: Model = Model {
    sigma: 0.0208,
    spans: &[
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.02842, -0.01693, 0.88380, 0.03391, 0.03276, 0.02009, -0.01757, -0.03549,
                -0.03712, -0.02439,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.02572, 0.02129, 0.01735, 0.01255, 0.01445, 0.00332],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[0.02572, 0.02129, 0.01735, 0.01255, 0.01445, 0.00332],
        },
    ],
};

pub(super) const SHOULDER: Model = Model {
    sigma: 0.0092,
    spans: &[
        Span {
            part: Part::Arm,
            first: 10,
            weights: &[
                -0.02795, -0.01862, -0.01052, -0.00152, 0.00588, 0.00564, 1.06528, -0.00269,
                -0.00306, -0.00282, -0.00285, -0.01081,
            ],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.00998, -0.00824, -0.00625, -0.00174, 0.00295, -0.00754],
        },
        Span {
            part: Part::Leg,
            first: 23,
            weights: &[-0.00351, 0.00013, 0.00833, 0.02187, 0.00635],
        },
        Span {
            part: Part::OtherLeg,
            first: 23,
            weights: &[-0.00959, -0.01130, -0.00201, 0.00616, 0.00129],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.00432, 0.00183, 0.00795, 0.01711, 0.01792, 0.01720, 0.00357, -0.00649, -0.01554,
                -0.02211,
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
                -0.05977, -0.00860, 0.04684, 0.02998, 0.80047, -0.02593, -0.05578, -0.04447,
                -0.01453, 0.00734, 0.02784, -0.04246,
            ],
        },
        Span {
            part: Part::OtherLeg,
            first: 16,
            weights: &[
                -0.03028, -0.00802, 0.02238, 0.06205, 0.05024, 0.03825, 0.02152, 0.00468, 0.00136,
                0.02450, 0.03572, 0.00845,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.06743, 0.05848, 0.04902, 0.02550, 0.01287, -0.00981],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.07907, -0.05961, -0.04263, -0.02208, 0.00461, -0.02011],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.08022, -0.04742, -0.00503, 0.03016, 0.03177, 0.02840, 0.02138, 0.03640, 0.03772,
                0.07046,
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
