//! One target, asked by many at once.

use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::SurfaceOrigin;
use std::{sync::mpsc, time::Duration};

/// Far more than the searches take; only a search that waits for itself takes as long.
const FOR_EVER: Duration = Duration::from_secs(60);

/// Points in the order of a generator whose every value is new, so that a sort has work.
fn points(n: u64) -> Vec<Point3<f64>> {
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 * 1e-5
    };
    (0..n).map(|_| Point3::new(next(), next(), next())).collect()
}

#[test]
fn a_tree_is_built_while_other_jobs_of_the_pool_ask_for_it_and_none_waits_for_itself() {
    let (done, result) = mpsc::sync_channel(1);
    std::thread::spawn(move || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let points = points(100_000);
        // Beyond the reach of the cells, so that the tree is asked.
        let far = points[7] + Vector3::new(-1e4, 0.0, 0.0);
        for round in 0..50 {
            let target = Target::new("ct", SurfaceOrigin::Exact, points.clone(), None).unwrap();
            target.prepare();
            let (answers, found) = mpsc::sync_channel(4);
            pool.in_place_scope(|scope| {
                let ask = || {
                    let (answers, target, far) = (answers.clone(), &target, &far);
                    scope.spawn(move |_| answers.send(target.nearest(far, f64::INFINITY)).unwrap());
                };
                // The first builds it; the others come while it does.
                ask();
                for _ in 0..3 {
                    std::thread::sleep(Duration::from_micros(100 * (1 + round)));
                    ask();
                }
            });
            drop(answers);
            let found: Vec<_> = found.iter().collect();
            assert!(found.len() == 4 && found.iter().all(|one| one.is_some() && *one == found[0]));
        }
        done.send(()).unwrap();
    });
    result.recv_timeout(FOR_EVER).expect("a search waits for itself, or has failed");
}
