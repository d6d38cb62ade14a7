//! An owner in the way of a grab, for the kinds that deny or queue it.

use mom_proto::{Code, Micros};

use crate::{Owner, Question, Terms, Verdict};

/// The other peer that owns the token, whatever its lease.
pub(crate) fn other_owner<'a>(question: &Question<'a>) -> Option<Owner<'a>> {
    question.token?.owner.filter(|owner| !owner.asks)
}

/// The other peer that owns the token by an unexpired lease.
pub(crate) fn lasting_owner<'a>(question: &Question<'a>) -> Option<Owner<'a>> {
    let lease_end = question.token?.lease_end;
    other_owner(question).filter(|_| lease_end.is_none_or(|end| question.now < end))
}

/// The refusal because of that owner.
pub(crate) fn held(question: &Question<'_>, rule: &str, owner: &Owner<'_>) -> Verdict {
    let earliest = question.token.and_then(|token| token.lease_end);
    let text = format!("{} is held by {}", question.context, owner.name);
    Verdict::deny(Code::HELD, rule, text).earliest(earliest)
}

/// The latest end of the ownership if the owner does not renew and the asking peer waits.
pub(crate) fn done_by(question: &Question<'_>, terms: &Terms) -> Option<Micros> {
    let token = question.token?;
    // Others may have waited longer, so the notice may end earlier.
    let held = terms.hold.map(|hold| {
        let noticed = question.now.saturating_add(terms.notice);
        token.since.saturating_add(hold).max(noticed)
    });
    [token.lease_end, held].into_iter().flatten().min()
}
