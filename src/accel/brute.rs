//! Every primitive is tested: the plain truth that other structures are checked against.

use super::tester::Tester;
use crate::geometry::Ray;
use crate::geometry::record::Answer;
use crate::scene::Surfaces;

/// The least (t, primitive id) of these primitives, or with `any` whether there is one.
pub(super) fn answer(surfaces: &Surfaces, ids: impl Iterator<Item = u32>, ray: &Ray, any: bool) -> Answer {
    let mut tester = Tester::new(surfaces, ray);
    for primitive in ids {
        tester.test(primitive);
        if any && tester.found() {
            break;
        }
    }
    tester.verdict(any)
}
