//! Scores of cases made by hand.
