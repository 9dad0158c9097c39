//! The functions of the standard library are those of the crate `libm`, to the last bit: on other systems than GNU/Linux nothing is promised.
#![cfg(all(target_os = "linux", target_env = "gnu"))]

use osteoflow_libm as _;
use std::{f64::consts, hint::black_box};

/// Numbers of both signs over the whole range of size, half of them about 1, always the same ones.
fn numbers() -> impl Iterator<Item = f64> {
    let mut state = 1_u64;
    let mut next = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
    };
    (0..20_000).map(move |n| if n % 2 == 0 { 3.0 * next() } else { next().signum() * 10_f64.powf(250.0 * next()) })
}

macro_rules! same {
    ($float:ty: $($std:ident $libm:ident),+) => {$(
        for x in numbers().map(|x| x as $float) {
            let (std, libm) = (black_box(x).$std(), libm::$libm(x));
            assert_eq!(std.to_bits(), libm.to_bits(), "{}({x:?}): {std:?}, not {libm:?}", stringify!($libm));
        }
    )+};
    ($float:ty, two: $($std:ident $libm:ident),+) => {$(
        for (x, y) in std::iter::zip(numbers(), numbers().skip(7)).map(|(x, y)| (x as $float, y as $float)) {
            let (std, libm) = (black_box(x).$std(black_box(y)), libm::$libm(x, y));
            assert_eq!(std.to_bits(), libm.to_bits(), "{}({x:?}, {y:?}): {std:?}, not {libm:?}", stringify!($libm));
        }
    )+};
}

#[test]
fn each_function_of_std_is_that_of_libm_to_the_last_bit() {
    same!(f64: sin sin, cos cos, tan tan, asin asin, acos acos, atan atan, sinh sinh, cosh cosh, tanh tanh);
    same!(f64: exp exp, exp2 exp2, exp_m1 expm1, ln log, log2 log2, log10 log10, ln_1p log1p, cbrt cbrt);
    same!(f64, two: atan2 atan2, powf pow, hypot hypot);
    same!(f32: sin sinf, cos cosf, tan tanf, asin asinf, acos acosf, atan atanf, sinh sinhf, cosh coshf, tanh tanhf);
    same!(f32: exp expf, exp2 exp2f, exp_m1 expm1f, ln logf, log2 log2f, log10 log10f, ln_1p log1pf, cbrt cbrtf);
    same!(f32, two: atan2 atan2f, powf powf, hypot hypotf);
}

/// Whether the compiler joins a sine and a cosine is its own choice.
#[test]
fn a_sine_and_a_cosine_of_one_number_are_those_of_two_calls() {
    for x in numbers() {
        let (sin, cos) = black_box(x).sin_cos();
        assert_eq!([sin, cos].map(f64::to_bits), [libm::sin(x), libm::cos(x)].map(f64::to_bits), "{x:?}");
        let x = x as f32;
        let (sin, cos) = black_box(x).sin_cos();
        assert_eq!([sin, cos].map(f32::to_bits), [libm::sinf(x), libm::cosf(x)].map(f32::to_bits), "{x:?}");
    }
}

/// Values of the tables of Abramowitz and Stegun: no function has the name of another, no argument the place of another.
#[test]
fn each_function_is_the_one_of_its_name() {
    let (sin, cos) = black_box(1.0_f64).sin_cos();
    let one = black_box(1.0_f64);
    for (name, found, known) in [
        ("sincos", sin, 0.841_470_984_807_896_5),
        ("sincos", cos, 0.540_302_305_868_139_7),
        ("sin", one.sin(), 0.841_470_984_807_896_5),
        ("cos", one.cos(), 0.540_302_305_868_139_7),
        ("tan", one.tan(), 1.557_407_724_654_902_3),
        ("sinh", one.sinh(), 1.175_201_193_643_801_4),
        ("cosh", one.cosh(), 1.543_080_634_815_243_7),
        ("tanh", one.tanh(), 0.761_594_155_955_764_9),
        ("atan2", one.atan2(2.0), 0.463_647_609_000_806_1),
        ("asin", (one / 2.0).asin(), consts::FRAC_PI_6),
        ("acos", (one / 2.0).acos(), consts::FRAC_PI_3),
        ("atan", (one / 2.0).atan(), 0.463_647_609_000_806_1),
        ("exp", one.exp(), consts::E),
        ("exp2", (one / 2.0).exp2(), consts::SQRT_2),
        ("expm1", one.exp_m1(), 1.718_281_828_459_045),
        ("log", (3.0 * one).ln(), 1.098_612_288_668_109_8),
        ("log2", (3.0 * one).log2(), 1.584_962_500_721_156),
        ("log10", (3.0 * one).log10(), 0.477_121_254_719_662_4),
        ("log1p", one.ln_1p(), consts::LN_2),
        ("cbrt", (2.0 * one).cbrt(), 1.259_921_049_894_873_2),
        ("pow", (2.0 * one).powf(1.5), 2.828_427_124_746_190_3),
        ("hypot", one.hypot(2.0), 2.236_067_977_499_79),
    ] {
        assert!((found / known - 1.0).abs() <= f64::EPSILON, "{name}: {found:?}, not {known:?}");
    }
}
