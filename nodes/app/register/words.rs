//! Words for what a method reports.

use osteoflow_algorithms::icp::{StopReason, WeakDirection};
use osteoflow_geometry::nalgebra::Vector3;

/// Share of a motion above which it is named a shift or a turn alone.
const MOSTLY: f64 = 0.95;

/// What a plugin reports of its convergence.
pub(crate) fn converged(stated: Option<bool>) -> &'static str {
    match stated {
        Some(true) => "yes, by its report",
        Some(false) => "NO, by its report",
        None => "not reported",
    }
}

/// Why a method stopped.
pub(crate) fn stop_reason(reason: StopReason) -> &'static str {
    match reason {
        StopReason::Step => "the remaining distance is below stop_step_mm",
        StopReason::Residual => "the residual changed by less than stop_residual_mm",
        StopReason::Iterations => "max_iterations are used up",
        StopReason::Time => "stop_after_ms are used up",
        StopReason::Stalled => "no step lowers the residual any more",
        StopReason::Cancelled => "interrupted",
    }
}

/// A motion in the target's frame: a shift, a turn about the source's centroid, or both.
pub(crate) fn describe(motion: &WeakDirection) -> String {
    let (shift, turn) = (Vector3::from(motion.translation), Vector3::from(motion.rotation));
    let axis = |v: &Vector3<f64>| {
        let unit = v.try_normalize(0.0).unwrap_or_default();
        format!("({:.2}, {:.2}, {:.2})", unit.x, unit.y, unit.z)
    };
    if shift.norm() > MOSTLY {
        format!("a shift along {}", axis(&shift))
    } else if turn.norm() > MOSTLY {
        format!("a turn about {}", axis(&turn))
    } else {
        format!("a shift along {} with a turn about {}", axis(&shift), axis(&turn))
    }
}

/// Three digits after the point, or one significant digit for small numbers.
pub(crate) fn short(number: f64) -> String {
    match number.abs() {
        0.0 => "0".into(),
        small if small < 1e-3 => format!("{number:.0e}"),
        _ => format!("{number:.3}"),
    }
}
