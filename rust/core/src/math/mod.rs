//! Linear algebra and numerics that do not depend on robots: SIMD number types, rows over the joints, factorizations,
//! singular values, rotations, sampling, threads.

/// Repeats the body for each index. Triangular loops in it then have constant bounds, and their values stay in
/// registers.
macro_rules! unrolled {
    ($i:ident in $($index:literal)* => $body:block) => {
        $({
            let $i: usize = $index;
            $body
        })*
    };
}

/// Defines a function over [`JointVector`](simd::JointVector): inlined, or a call if the type is `OUTLINED`.
macro_rules! outlined_formula {
    ($(#[$about:meta])* fn $name:ident<$j:ident>($($argument:ident: $type:ty),*) -> $output:ty as $body:ident) => {
        $(#[$about])*
        #[inline(always)]
        pub(crate) fn $name<$j: JointVector>($($argument: $type),*) -> $output {
            #[inline(never)]
            fn called<$j: JointVector>($($argument: $type),*) -> $output {
                $body($($argument),*)
            }
            if $j::OUTLINED { called($($argument),*) } else { $body($($argument),*) }
        }
    };
}

/// Marks the branch that calls it as unlikely. The compiler then keeps the branch, out of line, instead of computing and
/// selecting both results, so a step does not wait for the condition.
#[cold]
#[inline(never)]
pub(crate) fn cold() {}

pub(crate) mod halton;
pub(crate) mod ldlt6;
pub(crate) mod rotation;
pub(crate) mod rounding;
pub(crate) mod rows;
pub(crate) mod simd;
pub(crate) mod singular_values;
pub(crate) mod spatial;
pub(crate) mod spectral;
pub(crate) mod svd;
pub(crate) mod thread_pool;
