//! Every primitive is tested: the plain truth that other structures are checked against.

use super::Visitor;
use super::tester::Tester;

pub(super) fn traverse<const ANY: bool>(tester: &mut Tester) {
    for primitive in 0..tester.surfaces.len() as u32 {
        tester.test(primitive);
        if ANY && tester.found() {
            return;
        }
    }
}
