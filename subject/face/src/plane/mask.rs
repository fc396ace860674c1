//! Yes or no for each pixel, and its morphology.

use std::ops::DerefMut;

/// Yes or no a pixel, row by row from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    width: usize,
    height: usize,
    values: Vec<bool>,
}

impl Mask {
    /// Row after row of `values`; what is missing is no, and what is over is left out.
    #[must_use]
    pub fn from_values(width: usize, height: usize, mut values: Vec<bool>) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        values.resize(width * height, false);
        Self { width, height, values }
    }

    /// In pixels, 1 at least.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// In pixels, 1 at least.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All of them, row by row.
    #[must_use]
    pub fn values(&self) -> &[bool] {
        &self.values
    }

    /// Whether a pixel is in it; nothing outside is.
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> bool {
        x < self.width && self.values.get(y * self.width + x).copied().unwrap_or_default()
    }

    /// How many pixels are in it.
    #[must_use]
    pub fn count(&self) -> usize {
        self.values.iter().filter(|&&value| value).count()
    }

    /// What is not in it.
    #[must_use]
    pub fn inverted(&self) -> Self {
        Self { values: self.values.iter().map(|value| !value).collect(), ..*self }
    }

    /// Grown by a square of `2 * radius + 1` pixels.
    #[must_use]
    pub fn dilated(&self, radius: usize) -> Self {
        self.turned(radius, true)
    }

    /// Shrunk by the same square. The border does not shrink it: what lies outside counts as in it.
    #[must_use]
    pub fn eroded(&self, radius: usize) -> Self {
        self.turned(radius, false)
    }

    /// Shrunk, then grown: what is thinner than the square goes.
    #[must_use]
    pub fn opened(&self, radius: usize) -> Self {
        self.eroded(radius).dilated(radius)
    }

    /// Grown, then shrunk: gaps that are thinner than the square close.
    #[must_use]
    pub fn closed(&self, radius: usize) -> Self {
        self.dilated(radius).eroded(radius)
    }

    /// Every pixel within `radius` of one that is `to` becomes `to`: along the rows, then along the columns.
    fn turned(&self, radius: usize, to: bool) -> Self {
        let mut across = self.clone();
        for (from, into) in
            self.values.chunks_exact(self.width).zip(across.values.chunks_exact_mut(self.width))
        {
            spread(from.iter().copied(), into.iter_mut(), radius, to);
        }
        let mut out = across.clone();
        for x in 0..self.width {
            let from = across.values.iter().skip(x).step_by(self.width).copied();
            let into = out.values.iter_mut().skip(x).step_by(self.width);
            spread(from, into, radius, to);
        }
        out
    }
}

/// One line: the distance to the last `to`, from both sides, by two walks in one: a pixel is written once the walk is
/// `radius` beyond it.
fn spread<I: Iterator<Item: DerefMut<Target = bool>>>(
    from: impl Iterator<Item = bool>,
    into: I,
    radius: usize,
    to: bool,
) {
    let mut into = into;
    let mut last: Option<usize> = None;
    let mut length = 0;
    for (at, value) in from.enumerate() {
        length = at + 1;
        if value == to {
            last = Some(at);
        }
        if let Some(centre) = at.checked_sub(radius)
            && let Some(mut pixel) = into.next()
        {
            *pixel = decided(last, centre, radius, to);
        }
    }
    for (centre, mut pixel) in (length.saturating_sub(radius)..length).zip(into) {
        *pixel = decided(last, centre, radius, to);
    }
}

/// `to` if the last one is not further than `radius` before `centre`.
fn decided(last: Option<usize>, centre: usize, radius: usize, to: bool) -> bool {
    if last.is_some_and(|last| last + radius >= centre) { to } else { !to }
}
