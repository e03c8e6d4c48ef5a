//! Which webhooks are sent an event of an alert, also of one that a zone mutes.
//!
//! Only events that concern a decision are sent: not growing evidence, comments or assignees. What happens
//! while an alert is muted is withheld. When the muting ends, receivers are sent what they have missed:
//! `alert.raised` if they have not been sent the alert before, else `alert.updated`.

use crate::model::AlertEventKind;

/// What an event of an alert is to webhooks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sent {
    /// To those that are sent tentative alerts as well; `None` if they are sent nothing.
    pub(super) tentative: Option<AlertEventKind>,
    /// To those for which an alert begins when it is confirmed.
    pub(super) confirmed: Option<AlertEventKind>,
    /// The first revision that is withheld after it; `None` if nothing is.
    pub(super) withheld_from: Option<i64>,
}

/// Where an alert stands when something happens to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Standing {
    /// The first revision of the alert that the event is the news of: its own, or the next one if it is
    /// no revision.
    pub(super) news_from: i64,
    /// The revision with which it was first confirmed.
    pub(super) confirmed_revision: Option<i64>,
    /// The first revision that was withheld before.
    pub(super) withheld_from: Option<i64>,
    /// Whether a zone muted it before the event.
    pub(super) was_muted: bool,
    /// Whether a zone mutes it now.
    pub(super) muted: bool,
    /// Whether it waits for a decision.
    pub(super) pending: bool,
    /// Whether what a decision is about has changed with the event.
    pub(super) is_decision: bool,
}

impl Standing {
    /// What is sent of the event.
    pub(super) fn sent(&self) -> Sent {
        if self.muted {
            let own = self.is_decision.then_some(self.news_from);
            return Sent {
                tentative: None,
                confirmed: None,
                withheld_from: self.withheld_from.or(own),
            };
        }
        let is_made_good = self.was_muted && self.withheld_from.is_some();
        if !self.is_decision && !is_made_good {
            return Sent {
                tentative: None,
                confirmed: None,
                withheld_from: self.withheld_from,
            };
        }
        let from = self.withheld_from.unwrap_or(self.news_from);
        let kind = |begins: bool| match begins {
            true => AlertEventKind::Raised,
            false => AlertEventKind::Updated,
        };
        let tentative = kind(from == 1);
        let confirmed = self.confirmed_revision.map(|begun| kind(begun >= from));
        if self.pending || self.withheld_from.is_none() {
            return Sent {
                tentative: Some(tentative),
                confirmed,
                withheld_from: None,
            };
        }
        // It was decided about, or resolved, while it was muted: only receivers that know it are sent
        // that.
        let known = |kind: &AlertEventKind| *kind == AlertEventKind::Updated;
        let still_withheld = match (tentative, confirmed) {
            (AlertEventKind::Raised, _) => Some(from),
            (_, Some(AlertEventKind::Raised)) => self.confirmed_revision,
            _ => None,
        };
        Sent {
            tentative: Some(tentative).filter(known),
            confirmed: confirmed.filter(known),
            withheld_from: still_withheld,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAISED: Option<AlertEventKind> = Some(AlertEventKind::Raised);
    const UPDATED: Option<AlertEventKind> = Some(AlertEventKind::Updated);

    fn revision(revision: i64, confirmed_revision: Option<i64>) -> Standing {
        Standing {
            news_from: revision,
            confirmed_revision,
            withheld_from: None,
            was_muted: false,
            muted: false,
            pending: true,
            is_decision: true,
        }
    }

    fn sent(standing: Standing) -> (Option<AlertEventKind>, Option<AlertEventKind>, Option<i64>) {
        let sent = standing.sent();
        (sent.tentative, sent.confirmed, sent.withheld_from)
    }

    #[test]
    fn an_alert_begins_when_it_is_raised_or_confirmed() {
        assert_eq!(sent(revision(1, None)), (RAISED, None, None));
        assert_eq!(sent(revision(3, Some(3))), (UPDATED, RAISED, None));
        assert_eq!(sent(revision(4, Some(3))), (UPDATED, UPDATED, None));
    }

    #[test]
    fn what_no_decision_is_about_is_not_sent() {
        let grown = |withheld_from| Standing {
            withheld_from,
            is_decision: false,
            ..revision(4, Some(3))
        };
        assert_eq!(sent(grown(None)), (None, None, None));
        // What could not be made good stays withheld, whatever comments follow.
        assert_eq!(sent(grown(Some(1))), (None, None, Some(1)));
        let muted = Standing {
            muted: true,
            was_muted: true,
            ..grown(None)
        };
        assert_eq!(sent(muted), (None, None, None));
        let ended = Standing {
            was_muted: true,
            ..grown(None)
        };
        assert_eq!(sent(ended), (None, None, None), "nothing was missed");
    }

    #[test]
    fn what_was_withheld_is_made_good_when_the_zone_ends() {
        let raised = Standing {
            muted: true,
            ..revision(1, None)
        };
        assert_eq!(sent(raised), (None, None, Some(1)));
        let confirmed = Standing {
            muted: true,
            withheld_from: Some(1),
            ..revision(2, Some(2))
        };
        assert_eq!(sent(confirmed), (None, None, Some(1)));
        let ended = |withheld_from, pending| Standing {
            withheld_from,
            pending,
            was_muted: true,
            is_decision: false,
            ..revision(6, Some(2))
        };
        assert_eq!(sent(ended(Some(1), true)), (RAISED, RAISED, None));
        assert_eq!(sent(ended(Some(2), true)), (UPDATED, RAISED, None));
        assert_eq!(sent(ended(Some(4), true)), (UPDATED, UPDATED, None));
        // It was resolved meanwhile: those that know it are sent that, the others nothing.
        assert_eq!(sent(ended(Some(4), false)), (UPDATED, UPDATED, None));
        assert_eq!(sent(ended(Some(2), false)), (UPDATED, None, Some(2)));
        assert_eq!(sent(ended(Some(1), false)), (None, None, Some(1)));
    }
}
