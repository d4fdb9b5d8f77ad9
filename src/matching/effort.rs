//! What a search did, as JSON has it: how it ended is two keys there.

use serde::{Deserialize, Serialize};

use super::{Effort, SearchEnd};

/// The keys in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub(super) struct Written {
    hypotheses_possible: f64,
    hypotheses_tried: u64,
    /// The search ended before all hypotheses were tried.
    budget_spent: bool,
    /// A time limit ended it; older programs did not say.
    #[serde(default)]
    search_cut: bool,
}

impl From<Effort> for Written {
    fn from(effort: Effort) -> Self {
        Written {
            hypotheses_possible: effort.hypotheses_possible,
            hypotheses_tried: effort.hypotheses_tried,
            budget_spent: effort.ended != SearchEnd::Complete,
            search_cut: effort.ended == SearchEnd::TimeLimit,
        }
    }
}

impl From<Written> for Effort {
    fn from(written: Written) -> Self {
        Effort {
            hypotheses_possible: written.hypotheses_possible,
            hypotheses_tried: written.hypotheses_tried,
            ended: match (written.search_cut, written.budget_spent) {
                (true, _) => SearchEnd::TimeLimit,
                (false, true) => SearchEnd::BudgetSpent,
                (false, false) => SearchEnd::Complete,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_search_is_two_keys() {
        let ends = [
            (SearchEnd::Complete, [false, false]),
            (SearchEnd::BudgetSpent, [true, false]),
            (SearchEnd::TimeLimit, [true, true]),
        ];
        for (ended, [spent, cut]) in ends {
            let effort = Effort { hypotheses_possible: 1.5, hypotheses_tried: 2, ended };
            let text = serde_json::to_string(&effort).expect("plain data");
            let keys = r#"{"hypotheses_possible":1.5,"hypotheses_tried":2,"budget_spent":"#;
            assert_eq!(text, format!(r#"{keys}{spent},"search_cut":{cut}}}"#));
            assert_eq!(serde_json::from_str::<Effort>(&text).expect("as it was written"), effort);
        }
        let old = r#"{"hypotheses_possible":1.0,"hypotheses_tried":1,"budget_spent":true}"#;
        let old: Effort = serde_json::from_str(old).expect("of an older program");
        assert_eq!(old.ended, SearchEnd::BudgetSpent);
    }
}
