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
                -0.02888, -0.01822, -0.00894, 0.00088, 0.00835, 0.00715, 1.04126, -0.00399,
                -0.00529, -0.00550, -0.00477, -0.01702,
            ],
        },
        Span {
            part: Part::OtherArm,
            first: 16,
            weights: &[-0.01281, -0.01062, -0.00835, -0.00290, 0.00374, -0.00889],
        },
        Span {
            part: Part::Leg,
            first: 23,
            weights: &[-0.00282, 0.00058, 0.00945, 0.02452, 0.00663],
        },
        Span {
            part: Part::OtherLeg,
            first: 23,
            weights: &[-0.00887, -0.01206, -0.00185, 0.00795, 0.00532],
        },
        Span {
            part: Part::Head,
            first: 3,
            weights: &[
                -0.00330, 0.00393, 0.01275, 0.02074, 0.02211, 0.02359, 0.00886, -0.00587, -0.01499,
                -0.02187,
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
            -0.03980, -0.02950, -0.01555, -0.00470, 0.00222, 1.17341, -0.00220, -0.00689, -0.00783,
            -0.02184, -0.04732,
        ],
    }],
};

pub(super) const WRIST: Model = Model {
    sigma: 0.0062,
    spans: &[Span {
        part: Part::Arm,
        first: 0,
        weights: &[0.10466, -0.09955, -0.11408, 1.02014, 0.07731, 0.05750, 0.01666, -0.06264],
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
