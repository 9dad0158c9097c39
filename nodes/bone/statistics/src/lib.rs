//! Statistics for publications of registration experiments: plain functions on columns of numbers.
//!
//! A table of experiments has a row for each measured value: the error at a point, in a procedure, on a bone. Rows of one
//! procedure share its tracker and its start, rows of one bone share its shape, so they are not independent, and a thousand
//! of them on one bone say nothing about other bones. Each column of values therefore comes with [`Units`]: the bone,
//! procedure and point of each row, highest level first. **n is the number of units at the highest level**: 200 starts on
//! one scan of one bone are n = 1 bone.
//!
//! | Question | Function |
//! |---|---|
//! | how large are the errors? | [`Summary::of`] |
//! | how certain is that number, for other bones? | [`bootstrap_mean`], [`bootstrap`], [`bootstrap_rows`] |
//! | what share is below 2 mm? | [`wilson_clustered`], [`wilson`] for independent rows |
//! | is A better than B on the same procedures? | [`wilcoxon`], then [`holm`] over all pairs compared |
//! | are A and B equivalent? | [`tost`] with a margin stated beforehand |
//! | how well do two methods agree on one measurement? | [`bland_altman`] |
//! | how well does a measurement repeat? | [`repeatability`] |
//! | does the error depend on a cause? | [`pearson`], [`spearman`] |
//!
//! Tests and correlations assume independent rows. If rows repeat within a unit, compute one value per unit with
//! [`unit_means`] first.
//!
//! What cannot be computed is a [`StatisticsError`]. An estimate whose interval cannot be computed keeps its value together
//! with the reason ([`NoInterval`]), so that a table can print both. NaN and infinite values are refused: a run that failed
//! has no error in mm; it counts in a share, as a row that is not below the limit.
//!
//! Nothing here reads a file or a clock. Random draws come from ChaCha8 with the given seed, and sums do not depend on the
//! order of the rows, so the same table gives the same answer; where the C library is not GNU's, its `ln` and `exp` may differ in the
//! last digit. Distributions are those of the crate `statrs`; the known answers of the tests come from scipy
//! and statsmodels (`tests/golden.py`).
//!
//! ```
//! use osteoflow_statistics::{BootstrapParams, NoInterval, Summary, Units, bootstrap_mean, wilson_clustered};
//!
//! // Three bones, two procedures each: the error along z in mm.
//! let paths = [["A", "1"], ["A", "2"], ["B", "1"], ["B", "2"], ["C", "1"], ["C", "2"]];
//! let error_z_mm = [0.4, 0.6, -0.1, 0.1, 1.9, 2.1];
//! let units = Units::new(&["bone", "procedure"], &paths)?;
//! assert_eq!(units.n_units(), [3, 6]);
//!
//! let summary = Summary::of(&error_z_mm)?;
//! assert!((summary.mean - 0.833).abs() < 1e-3 && (summary.rms - 1.194).abs() < 1e-3);
//!
//! // Bones are resampled, each with all its rows.
//! let bias = bootstrap_mean(&units, &error_z_mm, &BootstrapParams::default())?;
//! let interval = bias.interval.expect("three bones");
//! assert!(interval.low < 0.1 && interval.high > 1.9);
//! assert!(bias.few_units, "three bones are fewer than five");
//!
//! let under_2_mm: Vec<bool> = error_z_mm.iter().map(|e| e.abs() <= 2.0).collect();
//! let share = wilson_clustered(&units, &under_2_mm, 0.95)?;
//! assert_eq!((share.n_hits, share.n), (5, 6));
//!
//! // One bone: the share is known, but not how other bones differ.
//! let one_bone = Units::new(&["bone", "procedure"], &paths[..2])?;
//! let share = wilson_clustered(&one_bone, &under_2_mm[..2], 0.95)?;
//! assert_eq!(share.share, 1.0);
//! assert_eq!(share.interval, Err(NoInterval::OneUnit { unit: "bone".into() }));
//! # Ok::<(), osteoflow_statistics::StatisticsError>(())
//! ```

// Linked for its symbols alone: the functions of C are the same on every processor.
use osteoflow_libm as _;

mod anova;
mod bland_altman;
mod bootstrap;
mod correlation;
mod counted;
mod distributions;
mod error;
mod hodges_lehmann;
mod holm;
mod interval;
mod quantile;
mod ranks;
mod repeatability;
mod summary;
mod tost;
mod units;
mod wilcoxon;
mod wilson;

pub use bland_altman::{BlandAltman, bland_altman};
pub use bootstrap::{Bootstrap, BootstrapKind, BootstrapParams, FEW_UNITS, bootstrap, bootstrap_mean, bootstrap_rows};
pub use correlation::{Correlation, pearson, spearman};
pub use counted::{counted, plural};
pub use error::StatisticsError;
pub use hodges_lehmann::hodges_lehmann;
pub use holm::holm;
pub use interval::{Interval, NoInterval};
pub use quantile::{median, quantile};
pub use repeatability::{Repeatability, repeatability};
pub use summary::Summary;
pub use tost::{Tost, tost};
pub use units::{UnitMeans, Units, unit_means};
pub use wilcoxon::{Wilcoxon, wilcoxon};
pub use wilson::{Share, wilson, wilson_clustered};
