//! Written by `benches/subject/learn.py` from the shapes mavg and favg: change it there.

use super::model::{Model, Part, Span};

pub(super) const HEAD: Model = Model {
    sigma: 0.0147,
    spans: &[Span {
        part: Part::Head,
        first: 0,
        weights: &[1.18063, 0.01030, -0.00203, -0.06941, -0.06275, -0.02842, -0.02832],
    }],
};

pub(super) const THROAT: Model = Model {
    sigma: 0.0306,
    spans: &[
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.02785, -0.02008, 0.92774, 0.02777, 0.02657, 0.01644, -0.01495, -0.03518,
                -0.03511, -0.02201,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.02224, 0.01753, 0.01345, 0.00970, 0.01239, 0.00302],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[0.02224, 0.01753, 0.01345, 0.00970, 0.01239, 0.00302],
        },
    ],
};

pub(super) const SHOULDER: Model = Model {
    sigma: 0.0115,
    spans: &[
        Span {
            part: Part::Arm,
            first: 10,
            weights: &[
                -0.02889, -0.01767, -0.00806, 0.00089, 0.00774, 0.00693, 1.03919, -0.00394,
                -0.00525, -0.00549, -0.00475, -0.01728,
            ],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.01302, -0.01075, -0.00844, -0.00294, 0.00375, -0.00908],
        },
        Span {
            part: Part::Leg,
            first: 23,
            weights: &[-0.00281, 0.00064, 0.00966, 0.02479, 0.00667],
        },
        Span {
            part: Part::OtherLeg,
            first: 23,
            weights: &[-0.00894, -0.01210, -0.00174, 0.00806, 0.00528],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.00335, 0.00401, 0.01297, 0.02104, 0.02246, 0.02398, 0.00908, -0.00572, -0.01494,
                -0.02198,
            ],
        },
    ],
};

pub(super) const ELBOW: Model = Model {
    sigma: 0.0118,
    spans: &[Span {
        part: Part::Arm,
        first: 5,
        weights: &[
            -0.03811, -0.02736, -0.01263, -0.00116, 0.00561, 1.16430, -0.00255, -0.00792, -0.00855,
            -0.02225, -0.04938,
        ],
    }],
};

pub(super) const WRIST: Model = Model {
    sigma: 0.0062,
    spans: &[Span {
        part: Part::Arm,
        first: 0,
        weights: &[0.10334, -0.09985, -0.11422, 1.02185, 0.07746, 0.05795, 0.01773, -0.06426],
    }],
};

pub(super) const HIP: Model = Model {
    sigma: 0.0195,
    spans: &[
        Span {
            part: Part::Leg,
            first: 16,
            weights: &[
                -0.05394, -0.00769, 0.04151, 0.02593, 0.79730, -0.02097, -0.04932, -0.04135,
                -0.01418, 0.00823, 0.02848, -0.03815,
            ],
        },
        Span {
            part: Part::OtherLeg,
            first: 16,
            weights: &[
                -0.02567, -0.00816, 0.01706, 0.05422, 0.04487, 0.03559, 0.02524, 0.01000, 0.00680,
                0.03396, 0.04014, 0.00667,
            ],
        },
        Span {
            part: Part::Arm,
            first: 16,
            weights: &[0.06585, 0.05556, 0.04588, 0.02151, 0.01114, -0.01426],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.07640, -0.05521, -0.03688, -0.01751, 0.00566, -0.02567],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.08096, -0.04623, -0.00074, 0.02429, 0.02518, 0.02320, 0.01938, 0.03781, 0.03810,
                0.06373,
            ],
        },
    ],
};

pub(super) const KNEE: Model = Model {
    sigma: 0.0102,
    spans: &[Span {
        part: Part::Leg,
        first: 8,
        weights: &[
            -0.01909, -0.01519, -0.00703, -0.00152, 1.08743, 0.00226, 0.00140, -0.00578, -0.01002,
            -0.03246,
        ],
    }],
};

pub(super) const ANKLE: Model = Model {
    sigma: 0.0102,
    spans: &[Span {
        part: Part::Leg,
        first: 0,
        weights: &[
            0.04717, -0.03840, -0.00202, -0.00084, 0.00390, 0.95950, 0.01682, 0.01098, -0.00440,
            0.00729,
        ],
    }],
};

pub(super) const UPPER_ARM: f64 = 0.1454;

pub(super) const THIGH: f64 = 0.2365;
