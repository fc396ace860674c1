//! One body of code, compiled twice: for every x86-64, and for those with AVX2 and BMI.
//!
//! Nothing here computes: the arithmetic is the same Rust, in the same order and never contracted, so
//! that both give the same bytes.

/// Work that is worth compiling twice. `run` and all that it calls must be `#[inline(always)]`.
pub(crate) trait Kernel {
    /// What it gives.
    type Output;

    fn run(self) -> Self::Output;
}

/// Which of the two to run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Isa {
    wide: bool,
}

impl Isa {
    /// The best that this machine has.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn detect() -> Self {
        let wide = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt");
        Self { wide }
    }

    /// The best that this machine has.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn detect() -> Self {
        Self::plain()
    }

    /// What every machine has.
    #[cfg(any(test, not(target_arch = "x86_64")))]
    pub(crate) const fn plain() -> Self {
        Self { wide: false }
    }

    #[inline]
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            #[expect(unsafe_code, reason = "a function of more CPU features than the crate's")]
            // SAFETY: `wide` is set by `detect` alone, which found all features that `wide` enables.
            return unsafe { wide(kernel) };
        }
        kernel.run()
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn wide<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}
