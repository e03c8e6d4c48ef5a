//! Every statement of the store is one that the database understands, whether or not a test
//! executes it. About SQLite: the statements are prepared past the store.

use std::collections::BTreeMap;

use sqlx::{AssertSqlSafe, Executor, SqlSafeStr, SqliteConnection};

use crate::sources::{Sources, sources};
use crate::sql_texts::{Macros, Text, Texts};
use crate::support::Fixture;

/// Statements that are composed while the program runs, which cannot be prepared from the source:
/// how many a file has, and which functions of the contract execute them. `coverage.rs` sees to it
/// that a test calls those.
pub const COMPOSED: [(&str, usize, &[&str]); 6] = [
    ("alerts.rs", 1, &["alert_page"]),
    ("audit.rs", 1, &["audit_page"]),
    ("comparison.rs", 2, &["compare"]),
    ("graph_rows.rs", 6, &["apply_result"]),
    ("intermediate_scans.rs", 1, &["apply_result"]),
    ("journal.rs", 1, &["batches"]),
];

/// Files that still have `?` for a value. None may be added; `$1` is understood by other
/// databases too.
const WITH_QUESTION_MARKS: [&str; 0] = [];

fn texts() -> BTreeMap<String, Texts> {
    texts_of(&sources("src/store"))
}

fn texts_of(files: &Sources) -> BTreeMap<String, Texts> {
    let mut macros = Macros::default();
    files.values().for_each(|file| macros.add(file));
    let read = |(name, file): (&String, &syn::File)| (name.clone(), Texts::of(file, &macros));
    files.iter().map(read).collect()
}

/// What the database says against a statement.
async fn refusal(database: &mut SqliteConnection, text: &Text) -> Option<String> {
    let statement = AssertSqlSafe(text.sql.clone()).into_sql_str();
    let prepared = database.prepare(statement).await;
    prepared.err().map(|error| error.to_string())
}

fn makes_a_table(sql: &str) -> bool {
    sql.starts_with("CREATE TABLE") || sql.starts_with("ALTER TABLE")
}

/// The complaints about all statements of some files, in the order of the text.
async fn refusals(database: &mut SqliteConnection, files: &BTreeMap<String, Texts>) -> Vec<String> {
    let mut found = Vec::new();
    for (file, texts) in files {
        for text in &texts.statements {
            if let Some(error) = refusal(database, text).await {
                found.push(format!("src/store/{file}:{}: {error}", text.line));
            }
            // Statements further down may be about what is made here.
            if makes_a_table(&text.sql) {
                let make = sqlx::query(AssertSqlSafe(text.sql.clone()));
                let _ = make.bind(0).execute(&mut *database).await;
            }
        }
    }
    found
}

/// A fresh database, with those that comparisons, copies and adoptions attach.
async fn database(fixture: &Fixture) -> SqliteConnection {
    let mut database = fixture.raw().await;
    let schema = "SELECT sql FROM sqlite_schema \
                  WHERE type = 'table' AND name NOT LIKE 'sqlite_%'";
    let tables: Vec<String> = sqlx::query_scalar(schema)
        .fetch_all(&mut database)
        .await
        .unwrap();
    let mut make = Vec::new();
    for attached in ["before", "other"] {
        make.push(format!("ATTACH ':memory:' AS {attached}"));
        let within = format!("CREATE TABLE {attached}.");
        make.extend(
            tables
                .iter()
                .map(|sql| sql.replace("CREATE TABLE ", &within)),
        );
    }
    for made_by_rebuilding in [
        "CREATE TABLE rebuild_ids (batch_key INTEGER PRIMARY KEY, node_id INTEGER, edge_id INTEGER)",
        "CREATE TABLE other.rebuild_batches AS SELECT *, 0 AS touched FROM other.batches",
    ] {
        make.push(made_by_rebuilding.to_owned());
    }
    for sql in make {
        let made = sqlx::raw_sql(AssertSqlSafe(sql)).execute(&mut database);
        made.await.unwrap();
    }
    database
}

#[tokio::test]
async fn every_statement_is_understood_by_a_fresh_database() {
    let fixture = Fixture::new().await;
    let mut database = database(&fixture).await;
    let files = texts();
    let found = refusals(&mut database, &files).await;
    assert!(found.is_empty(), "\n{}", found.join("\n"));
    for (file, texts) in &files {
        assert!(
            texts.unread.is_empty(),
            "src/store/{file}: SQL in a macro that is not understood, lines {:?}",
            texts.unread
        );
    }
    let all: usize = files.values().map(|texts| texts.statements.len()).sum();
    assert!(all > 250, "only {all} statements were found");
}

#[test]
fn what_is_composed_is_in_the_list() {
    let count =
        |(file, texts): (String, Texts)| (texts.composed > 0).then_some((file, texts.composed));
    let found: BTreeMap<String, usize> = texts().into_iter().filter_map(count).collect();
    let listed = COMPOSED
        .iter()
        .map(|(file, count, _)| ((*file).to_owned(), *count));
    assert_eq!(found, listed.collect());
}

/// Whether a text has a `?` outside what is quoted.
fn has_question_mark(sql: &str) -> bool {
    sql.split('\'').step_by(2).any(|part| part.contains('?'))
}

#[test]
fn values_are_numbered() {
    let mut found = BTreeMap::new();
    for (file, texts) in texts() {
        let all = texts.statements.iter().chain(&texts.pieces);
        let marked = all.filter(|text| has_question_mark(&text.sql));
        let lines: Vec<usize> = marked.map(|text| text.line).collect();
        if !lines.is_empty() {
            found.insert(file, lines);
        }
    }
    let is_allowed = |file: &str| WITH_QUESTION_MARKS.contains(&file);
    let new: Vec<_> = found.iter().filter(|(file, _)| !is_allowed(file)).collect();
    assert!(new.is_empty(), "`?` in these lines, write `$1`: {new:?}");
    for file in WITH_QUESTION_MARKS {
        let has_some = found.contains_key(file);
        assert!(has_some, "{file} has no `?` left: take it off the list");
    }
}

/// The numbers of the values that a statement takes.
fn values_of(sql: &str) -> Vec<usize> {
    let after = sql.split('$').skip(1);
    let digits = after.map(|rest| rest.split(|c: char| !c.is_ascii_digit()).next().unwrap());
    let mut numbers: Vec<usize> = digits.filter_map(|digits| digits.parse().ok()).collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

#[test]
fn no_number_of_a_value_is_left_out() {
    for (file, texts) in texts() {
        for text in &texts.statements {
            let values = values_of(&text.sql);
            let expected: Vec<usize> = (1..=values.len()).collect();
            assert_eq!(values, expected, "src/store/{file}:{}", text.line);
        }
    }
}

#[tokio::test]
async fn a_planted_bad_text_is_found() {
    let fixture = Fixture::new().await;
    let mut database = database(&fixture).await;
    for (source, line) in [
        ("fn f() {\n sqlx::query(\"SELECT id FROM rooms\"); }", 2),
        ("fn f() { sqlx::query_scalar::<_, i64>(\"SELCT 1\"); }", 1),
        ("const LAW: &str = \"SELECT colour FROM routes\";", 1),
        (
            "fn f() { let s = [(\"jobs\",\n\n \"DELETE FROM jobs WHERE no = $1\")]; }",
            3,
        ),
        (
            "macro_rules! select { ($a:literal, $b:expr) => { concat!(\"SELECT \", $a, \" FROM \", $b) }; }\n\
             fn f() { sqlx::query(select!(\"id\", concat!(\"routes \", \"WHERE name = \", 1))); }",
            2,
        ),
        (
            "fn f() { g(async { tokio::join!(sqlx::query(\"UPDATE routes SET a = 1\")) }) }",
            1,
        ),
        (
            "impl A { async fn f() { match a { B => sqlx::query(\"INSERT INTO routes VALUES (1)\") } } }",
            1,
        ),
    ] {
        let file = BTreeMap::from([("planted.rs".to_owned(), syn::parse_file(source).unwrap())]);
        let found = refusals(&mut database, &texts_of(&file)).await;
        assert_eq!(found.len(), 1, "{source}: {found:?}");
        let place = format!("src/store/planted.rs:{line}: ");
        assert!(found[0].starts_with(&place), "{source}: {found:?}");
    }
}

#[tokio::test]
async fn what_is_good_or_for_tests_is_left_alone() {
    let fixture = Fixture::new().await;
    let mut database = database(&fixture).await;
    let source = "
        macro_rules! columns { () => { \"id, stage\" }; }
        macro_rules! select {
            ($rest:literal) => { select!(columns!(), $rest) };
            ($columns:expr, $rest:literal) => { concat!(\"SELECT \", $columns, \" FROM routes \", $rest) };
        }
        fn f() { sqlx::query(select!(\"WHERE id = '?' AND revision = $1\")); }
        fn g() { QueryBuilder::new(\"SELECT id FROM rooms\").push(\" WHERE a = ?\"); }
        fn h() { sqlx::query(AssertSqlSafe(format!(\"SELECT {a}\"))); log(\"Selected\"); }
        #[cfg(test)]
        mod tests { fn f() { sqlx::query(\"SELECT id FROM rooms\"); } }";
    let file = BTreeMap::from([("good.rs".to_owned(), syn::parse_file(source).unwrap())]);
    let texts = texts_of(&file);
    assert_eq!(refusals(&mut database, &texts).await, Vec::<String>::new());
    let [statement] = texts["good.rs"].statements.as_slice() else {
        panic!("{:?}", texts["good.rs"].statements)
    };
    assert_eq!(
        statement.sql,
        "SELECT id, stage FROM routes WHERE id = '?' AND revision = $1"
    );
    assert!(!has_question_mark(&statement.sql));
    assert_eq!(texts["good.rs"].composed, 2);
    let pieces = texts["good.rs"].pieces.iter();
    let marked = pieces.filter(|piece| has_question_mark(&piece.sql));
    assert_eq!(marked.count(), 1);
}

#[test]
#[ignore = "prints figures and checks nothing: --ignored --nocapture statements::figures"]
#[allow(clippy::print_stdout)]
fn figures() {
    let files = texts();
    let (mut statements, mut composed) = (0, 0);
    for (file, texts) in &files {
        let here = texts.statements.len();
        if here + texts.composed > 0 {
            println!("{here:4} statements, {:2} composed: {file}", texts.composed);
        }
        statements += here;
        composed += texts.composed;
    }
    println!(
        "{statements} statements, {composed} composed, {} files",
        files.len()
    );
}
