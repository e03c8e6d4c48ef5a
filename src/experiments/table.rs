//! Tables as Markdown, aligned so that they read well as they are.

use std::fmt::Write;

/// A table under a heading, with remarks.
#[derive(Debug, Clone)]
pub struct Table {
    title: String,
    head: Vec<String>,
    rows: Vec<Vec<String>>,
    remarks: Vec<String>,
}

impl Table {
    /// An empty table.
    pub fn new(title: impl Into<String>, head: &[&str]) -> Self {
        Self {
            title: title.into(),
            head: head.iter().map(|cell| (*cell).to_owned()).collect(),
            rows: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// A row; missing cells are empty.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// A line below the table.
    pub fn remark(&mut self, text: impl Into<String>) {
        self.remarks.push(text.into());
    }

    /// The text.
    pub fn text(&self) -> String {
        let width = |column: usize| {
            let all = std::iter::once(&self.head).chain(&self.rows);
            let cells = all.filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.head.len()).map(width).collect();
        let line = |cells: &[String]| {
            let mut text = String::from("|");
            for (column, width) in widths.iter().enumerate() {
                let cell = cells.get(column).map_or("", String::as_str);
                let _ = write!(text, " {cell:<width$} |");
            }
            text
        };
        let rule: Vec<String> = widths.iter().map(|width| "-".repeat(*width)).collect();
        let mut text = format!(
            "### {}\n\n{}\n{}\n",
            self.title,
            line(&self.head),
            line(&rule)
        );
        for row in &self.rows {
            let _ = writeln!(text, "{}", line(row));
        }
        for remark in &self.remarks {
            let _ = write!(text, "\n{remark}\n");
        }
        text
    }
}

/// Two decimals, or a dash.
pub fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.2}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_straight() {
        let mut table = Table::new("Results", &["ρ", "found"]);
        table.row(["0.5 m".to_owned(), number(Some(0.5))]);
        table.row(["1 m".to_owned()]);
        table.remark("Counts in brackets.");
        let expected = "### Results\n\n\
                        | ρ     | found |\n\
                        | ----- | ----- |\n\
                        | 0.5 m | 0.50  |\n\
                        | 1 m   |       |\n\
                        \nCounts in brackets.\n";
        assert_eq!(table.text(), expected);
    }
}
