//! The mathematical functions of C, with the same bits on every processor.
//!
//! The C library of GNU/Linux chooses between implementations of `sin`, `exp` and others by the processor on which a program starts,
//! and these differ in the last bit. This crate defines the functions under their names in C by those of the crate `libm`. The linker
//! binds to them every call in a program, also those of the standard library and of the program's libraries. Naming the crate suffices:
//!
//! ```
//! use osteoflow_libm as _;
//!
//! assert_eq!(0.5_f64.sin(), libm::sin(0.5));
//! ```
//!
//! The symbols are hidden: a shared library exports none of them, and what a program loads keeps its own functions. Square roots,
//! roundings and remainders are not here, since they are exact everywhere. On other systems the crate is empty.
#![no_std]
#![allow(unsafe_code, reason = "defines symbols of C")]

#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod symbols {
    macro_rules! define {
        (@ $float:ty, $name:ident($($x:ident),+)) => {
            core::arch::global_asm!(concat!(".hidden ", stringify!($name)));
            #[unsafe(no_mangle)]
            extern "C" fn $name($($x: $float),+) -> $float {
                libm::$name($($x),+)
            }
        };
        ($float:ty, $arguments:tt: $($name:ident)+) => {$(define!(@ $float, $name $arguments);)+};
    }

    define!(f64, (x): sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh);
    define!(f64, (x): exp exp2 exp10 expm1 log log2 log10 log1p cbrt);
    define!(f64, (x, y): atan2 pow hypot);
    define!(f32, (x): sinf cosf tanf asinf acosf atanf sinhf coshf tanhf asinhf acoshf atanhf);
    define!(f32, (x): expf exp2f exp10f expm1f logf log2f log10f log1pf cbrtf);
    define!(f32, (x, y): atan2f powf hypotf);

    // The compiler calls these for a sine and a cosine of one number.
    macro_rules! define_both {
        ($float:ty, $name:ident) => {
            core::arch::global_asm!(concat!(".hidden ", stringify!($name)));
            #[unsafe(no_mangle)]
            unsafe extern "C" fn $name(x: $float, sin: *mut $float, cos: *mut $float) {
                let both = libm::$name(x);
                // SAFETY: as in C, both pointers are to numbers of the caller.
                unsafe { (*sin, *cos) = both };
            }
        };
    }

    define_both!(f64, sincos);
    define_both!(f32, sincosf);
}
