//! Function multiversioning: kernels are compiled for the baseline x86-64 and for AVX2 with BMI, and chosen at run
//! time.
//!
//! Both versions are compiled from the same Rust, with the same order of operations and no fused operations, so that
//! both give the same bytes.

/// A computation that is compiled for both instruction sets. `run` and every function it calls must be
/// `#[inline(always)]`.
pub(crate) trait Kernel {
    /// The result.
    type Output;

    fn run(self) -> Self::Output;
}

/// The instruction set to run kernels with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Isa {
    wide: bool,
}

impl Isa {
    /// The widest that this machine supports.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn detect() -> Self {
        let wide = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt");
        Self { wide }
    }

    /// The widest that this machine supports.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn detect() -> Self {
        Self::plain()
    }

    /// The baseline that every machine has.
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
