//! Holds the documents to what they describe: links and anchors, commands with their flags, variables, paths
//! of the API. The tutorial itself is run by `tests/documentation/run`.

// Clippy lets tests unwrap, and not yet what they call.
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

const MAPSHIFT: &str = env!("CARGO_BIN_EXE_mapshift");
/// Where nothing is ours.
const NOT_OURS: [&str; 4] = ["target", "node_modules", ".git", "data"];

/// A Markdown file: its text, and what stands in its code, in fences and in backticks.
struct Page {
    path: PathBuf,
    /// Without fenced code.
    prose: String,
    /// The lines of fenced code, continued ones joined, and what is in backticks.
    code: Vec<String>,
}

impl Page {
    fn of(path: PathBuf, text: &str) -> Self {
        let (mut prose, mut code) = (String::new(), Vec::new());
        let (mut in_fence, mut continued) = (false, String::new());
        for line in text.lines() {
            if line.trim_start().starts_with("```") {
                in_fence = !in_fence;
            } else if !in_fence {
                prose.push_str(line);
                prose.push('\n');
            } else if let Some(begin) = line.strip_suffix('\\') {
                continued.push_str(begin);
            } else {
                code.push(std::mem::take(&mut continued) + line);
            }
        }
        assert!(!in_fence, "{}: a fence is not closed", path.display());
        let in_backticks = prose.split('`').skip(1).step_by(2);
        code.extend(in_backticks.map(|span| span.replace('\n', " ")));
        Self { path, prose, code }
    }

    /// The targets of its links and pictures.
    fn links(&self) -> Vec<&str> {
        let text = self.prose.split("](").skip(1);
        text.filter_map(|rest| Some(rest.split_once(')')?.0.trim()))
            .collect()
    }

    /// The names by which headings are linked, as GitHub makes them.
    fn anchors(&self) -> BTreeSet<String> {
        let mut count = BTreeMap::<String, usize>::new();
        let lines = self.prose.lines();
        let headings = lines.filter_map(|line| {
            line.trim_start_matches('#')
                .strip_prefix(' ')
                .filter(|_| line.starts_with('#'))
        });
        let mut name = |heading: &str| {
            let kept = heading
                .trim()
                .chars()
                .filter(|c| c.is_alphanumeric() || " -_".contains(*c));
            let slug = kept.collect::<String>().to_lowercase().replace(' ', "-");
            let seen = count.entry(slug.clone()).or_default();
            *seen += 1;
            match *seen {
                1 => slug,
                again => format!("{slug}-{}", again - 1),
            }
        };
        headings
            .map(|heading| name(&without_links(heading)))
            .collect()
    }

    /// Prose and code.
    fn texts(&self) -> impl Iterator<Item = &str> {
        self.code.iter().chain([&self.prose]).map(String::as_str)
    }
}

/// `[text](target)` becomes `text`.
fn without_links(heading: &str) -> String {
    let mut parts = heading.split("](");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| {
        text + part.split_once(')').map_or("", |(_, rest)| rest)
    })
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Files of the project below a directory of which `is_wanted` likes the name.
fn files(directory: &Path, is_wanted: &dyn Fn(&str) -> bool) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(directory).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if entry.file_type().unwrap().is_dir() && !NOT_OURS.contains(&name.as_str()) {
            found.extend(files(&entry.path(), is_wanted));
        } else if entry.file_type().unwrap().is_file() && is_wanted(&name) {
            found.push(entry.path());
        }
    }
    found
}

fn pages() -> Vec<Page> {
    let paths = files(root(), &|name| name.ends_with(".md"));
    let page = |path: PathBuf| {
        let text = std::fs::read_to_string(&path).unwrap();
        Page::of(path.strip_prefix(root()).unwrap().to_owned(), &text)
    };
    let pages: Vec<Page> = paths.into_iter().map(page).collect();
    assert!(pages.iter().any(|page| page.path == Path::new("README.md")));
    pages
}

fn assert_none(wrong: &[String]) {
    assert!(wrong.is_empty(), "\n{}\n", wrong.join("\n"));
}

/// What is printed with these arguments; empty if they are refused.
fn printed(arguments: &[&str]) -> String {
    let output = Command::new(MAPSHIFT).args(arguments).output().unwrap();
    match output.status.success() {
        true => String::from_utf8(output.stdout).unwrap(),
        false => String::new(),
    }
}

#[test]
fn links_lead_somewhere() {
    let pages = pages();
    let mut wrong = Vec::new();
    for page in &pages {
        for link in page.links() {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let directory = page.path.parent().unwrap();
            let target = match file {
                "" => root().join(&page.path),
                file => root().join(directory).join(file),
            };
            let Ok(target) = target.canonicalize() else {
                wrong.push(format!("{}: {link} is not there", page.path.display()));
                continue;
            };
            let mut targets = pages.iter();
            let target = targets.find(|p| root().join(&p.path).canonicalize().unwrap() == target);
            if !anchor.is_empty() && !target.is_some_and(|p| p.anchors().contains(anchor)) {
                wrong.push(format!(
                    "{}: {link} has no such heading",
                    page.path.display()
                ));
            }
        }
    }
    assert_none(&wrong);
}

/// A use of the binary in a line of code: its words up to the end of the command. What follows an option
/// (`-u mapshift`) is the name of something else.
fn uses(line: &str) -> Vec<Vec<&str>> {
    let line = line.split(" #").next().unwrap_or_default();
    let mut uses = Vec::new();
    for command in line.split(['|', ';', '&', '(', ')', '>', '<']) {
        let words: Vec<&str> = command.split_whitespace().collect();
        let is_binary = |k: &usize| {
            let is_named = words[*k] == "mapshift" || words[*k].ends_with("/mapshift");
            is_named && (*k == 0 || !words[*k - 1].starts_with('-'))
        };
        let last = (0..words.len()).rfind(is_binary);
        uses.extend(last.map(|k| words[k + 1..].to_vec()));
    }
    uses
}

fn is_name(word: &str) -> bool {
    let mut letters = word.chars();
    !word.is_empty()
        && letters.all(|c| c.is_ascii_lowercase() || c == '-')
        && !word.starts_with('-')
}

#[test]
fn commands_and_flags_exist() {
    let mut helps = BTreeMap::<Vec<String>, String>::new();
    let mut help = |command: &[&str]| -> String {
        let key: Vec<String> = command.iter().map(|&word| word.to_owned()).collect();
        let ask = || printed(&[command, &["--help"]].concat());
        helps.entry(key).or_insert_with(ask).clone()
    };
    let mut wrong = Vec::new();
    let mut count = 0;
    for page in &pages() {
        for words in page.code.iter().flat_map(|line| uses(line)) {
            let Some(&command) = words.first().filter(|word| is_name(word)) else {
                continue;
            };
            count += 1;
            let mut path = vec![command];
            let mut text = help(&path);
            if let Some(second) = words.get(1).filter(|word| is_name(word))
                && text.contains("Commands:")
            {
                path.push(second);
                text = help(&path);
            }
            let of = format!("{}: mapshift {}", page.path.display(), path.join(" "));
            if text.is_empty() {
                wrong.push(format!("{of} does not exist"));
                continue;
            }
            let known = text.split([' ', '\n', '=', ',', '[', ']', '.']);
            let known: BTreeSet<&str> = known.filter(|w| w.starts_with("--")).collect();
            let flags = words.iter().filter(|w| w.starts_with("--") && w.len() > 2);
            let flags = flags.map(|w| w.split('=').next().unwrap());
            let flags = flags.map(|w| w.trim_end_matches(|c: char| !c.is_ascii_lowercase()));
            let unknown = flags.filter(|flag| !known.contains(flag));
            wrong.extend(unknown.map(|flag| format!("{of} has no {flag}")));
        }
    }
    assert!(
        count > 10,
        "only {count} uses of the binary were recognised"
    );
    assert_none(&wrong);
}

/// What is written `mapshift …` is recognised, whatever is around it.
#[test]
fn uses_of_the_binary_are_recognised() {
    let words = |line| uses(line).concat().join(" ");
    assert_eq!(
        words("curl x | mapshift score a.log --seeds 3   # new --run"),
        "score a.log --seeds 3"
    );
    assert_eq!(
        words("sudo -u mapshift /usr/bin/mapshift fsck --data d"),
        "fsck --data d"
    );
    assert_eq!(words("useradd --user mapshift"), "");
    assert_eq!(
        words("docker exec mapshift mapshift keys list"),
        "keys list"
    );
}

/// The names in a text that begin with `MAPSHIFT_`, without it.
fn variables(text: &str) -> impl Iterator<Item = &str> {
    let is_end = |c: char| !(c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_');
    let rests = text.split("MAPSHIFT_").skip(1);
    let names = rests.map(move |rest| rest.split(is_end).next().unwrap_or_default());
    names.filter(|name| !name.is_empty())
}

#[test]
fn variables_exist() {
    let is_code = |name: &str| !name.ends_with(".md") && !name.ends_with(".svg");
    let texts = files(root(), &is_code);
    let texts: Vec<String> = texts
        .iter()
        .filter_map(|path| std::fs::read_to_string(path).ok())
        .collect();
    let known: BTreeSet<&str> = texts.iter().flat_map(|text| variables(text)).collect();
    let mut wrong = Vec::new();
    for page in &pages() {
        for name in page.texts().flat_map(variables) {
            if !known.contains(name) {
                wrong.push(format!(
                    "{}: nothing reads MAPSHIFT_{name}",
                    page.path.display()
                ));
            }
        }
    }
    assert_none(&wrong);
}

/// `a.{png,pgm}` as `a.png` and `a.pgm`; `{route}` stays.
fn spelled_out(path: &str) -> Vec<String> {
    let choice = path.split_once('{').and_then(|(head, rest)| {
        let (choices, tail) = rest.split_once('}')?;
        choices.contains(',').then_some((head, choices, tail))
    });
    match choice {
        Some((head, choices, tail)) => {
            let each = choices.split(',');
            each.map(|one| format!("{head}{}{tail}", one.trim()))
                .collect()
        }
        None => vec![path.to_owned()],
    }
}

/// Whether a path is one of the template's: `{…}` stands for any segment.
fn is_of(template: &str, path: &str) -> bool {
    let (template, path): (Vec<_>, Vec<_>) =
        (template.split('/').collect(), path.split('/').collect());
    let same = |(t, p): (&&str, &&str)| t == p || (t.starts_with('{') && !p.is_empty());
    template.len() == path.len() && template.iter().zip(&path).all(same)
}

#[test]
fn paths_of_the_api_exist() {
    let document: serde_json::Value = serde_json::from_str(&printed(&["openapi"])).unwrap();
    let templates: Vec<&String> = document["paths"].as_object().unwrap().keys().collect();
    let is_part = |c: char| c.is_ascii_alphanumeric() || "/._-{},$…".contains(c);
    let mut wrong = Vec::new();
    let mut count = 0;
    for page in &pages() {
        let rests = page.texts().flat_map(|text| text.split("/v1/").skip(1));
        for rest in rests {
            let end = rest.find(|c| !is_part(c)).unwrap_or(rest.len());
            let path = rest[..end].trim_end_matches(['.', ',', '/']);
            if path.is_empty() || path.contains('…') || path.contains("...") {
                continue;
            }
            for path in spelled_out(&format!("/v1/{path}")) {
                count += 1;
                if !templates.iter().any(|template| is_of(template, &path)) {
                    wrong.push(format!("{}: there is no {path}", page.path.display()));
                }
            }
        }
    }
    assert!(count > 20, "only {count} paths were recognised");
    assert_none(&wrong);
}

#[test]
fn a_page_is_read_as_it_is_shown() {
    let text = "# A *b*: `c d`\n\n## [Who](x.md#y) may\n\nSee [this](a.md), `mapshift\nfsck`.\n\n```sh\ncurl \\\n  /v1/keys\n```\n\n## A b c d\n";
    let page = Page::of(PathBuf::from("x.md"), text);
    assert_eq!(page.links(), ["x.md#y", "a.md"]);
    let anchors: Vec<String> = page.anchors().into_iter().collect();
    assert_eq!(anchors, ["a-b-c-d", "a-b-c-d-1", "who-may"]);
    assert!(page.code.contains(&"curl   /v1/keys".to_owned()));
    assert!(page.code.contains(&"mapshift fsck".to_owned()));
    assert_eq!(spelled_out("/v/map.{a,b}"), ["/v/map.a", "/v/map.b"]);
    assert!(is_of("/v1/routes/{route}", "/v1/routes/$ROUTE"));
    assert!(!is_of("/v1/routes/{route}", "/v1/routes/a/b"));
}
