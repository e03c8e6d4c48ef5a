//! Words and signs of a Rust source.

/// A word (an identifier, a keyword or a number), `::`, or any other character.
#[derive(Debug, Clone)]
pub struct Token {
    /// Where it stands, from 1.
    pub line: usize,
    /// As it is written.
    pub text: String,
}

impl Token {
    /// Whether it is an identifier, a keyword or a number.
    pub fn is_word(&self) -> bool {
        self.text.starts_with(is_word_part)
    }
}

fn is_word_part(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The tokens of a text without its comments, strings and characters.
pub fn tokens(text: &str) -> Vec<Token> {
    let chars: Vec<char> = text.chars().collect();
    let (mut tokens, mut at, mut line) = (Vec::new(), 0, 1);
    while at < chars.len() {
        let rest = &chars[at..];
        let left_out = comment(rest).or_else(|| literal(rest));
        let length = left_out.unwrap_or_else(|| match rest {
            [':', ':', ..] => 2,
            _ => rest.iter().take_while(|c| is_word_part(**c)).count().max(1),
        });
        let text: String = rest[..length].iter().collect();
        let (here, lines) = (line, text.matches('\n').count());
        if left_out.is_none() && !text.trim().is_empty() {
            tokens.push(Token { line: here, text });
        }
        line += lines;
        at += length;
    }
    tokens
}

/// The length of a comment that begins here.
fn comment(rest: &[char]) -> Option<usize> {
    match rest {
        ['/', '/', ..] => Some(rest.iter().take_while(|c| **c != '\n').count()),
        ['/', '*', ..] => {
            let (mut depth, mut at) = (1, 2);
            while depth > 0 && at < rest.len() {
                let step = match &rest[at..] {
                    ['/', '*', ..] => (1, 2),
                    ['*', '/', ..] => (-1, 2),
                    _ => (0, 1),
                };
                depth += step.0;
                at += step.1;
            }
            Some(at)
        }
        _ => None,
    }
}

/// The length of a string or a character that begins here.
fn literal(rest: &[char]) -> Option<usize> {
    match rest {
        ['"', ..] => Some(escaped(rest, '"')),
        ['\'', '\\', ..] => Some(escaped(rest, '\'')),
        ['\'', _, '\'', ..] => Some(3),
        ['r', '"' | '#', ..] => raw_string(&rest[1..]).map(|length| 1 + length),
        ['b' | 'c', 'r', '"' | '#', ..] => raw_string(&rest[2..]).map(|length| 2 + length),
        _ => None,
    }
}

/// The length of a text between quotes with backslashes in it.
fn escaped(rest: &[char], quote: char) -> usize {
    let mut at = 1;
    while at < rest.len() && rest[at] != quote {
        at += if rest[at] == '\\' { 2 } else { 1 };
    }
    (at + 1).min(rest.len())
}

/// The length of a raw string after its `r`.
fn raw_string(rest: &[char]) -> Option<usize> {
    let hashes = rest.iter().take_while(|c| **c == '#').count();
    if rest.get(hashes) != Some(&'"') {
        return None;
    }
    let ends = |at: &usize| {
        let end = rest.get(*at..=at + hashes);
        end.is_some_and(|end| end[0] == '"' && end[1..].iter().all(|c| *c == '#'))
    };
    let end = (hashes + 1..rest.len()).find(ends)?;
    Some(end + hashes + 1)
}

const TEST_ATTRIBUTE: [&str; 7] = ["#", "[", "cfg", "(", "test", ")", "]"];

/// The tokens without what `#[cfg(test)]` stands before, and the names of the modules in files
/// of their own among that.
pub fn without_tests(tokens: Vec<Token>) -> (Vec<Token>, Vec<String>) {
    let (mut kept, mut modules) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < tokens.len() {
        let window = tokens[at..].iter().take(TEST_ATTRIBUTE.len());
        if window.map(|t| t.text.as_str()).eq(TEST_ATTRIBUTE) {
            let item = &tokens[at + TEST_ATTRIBUTE.len()..];
            let length = item_length(item);
            let words: Vec<&str> = item[..length].iter().map(|t| t.text.as_str()).collect();
            if let [.., "mod", name, ";"] = words.as_slice() {
                modules.push((*name).to_owned());
            }
            at += TEST_ATTRIBUTE.len() + length;
        } else {
            kept.push(tokens[at].clone());
            at += 1;
        }
    }
    (kept, modules)
}

/// Tokens up to the first `;`, or to the end of the first braces.
fn item_length(tokens: &[Token]) -> usize {
    let mut depth = 0;
    for (at, token) in tokens.iter().enumerate() {
        match token.text.as_str() {
            "{" => depth += 1,
            "}" => depth -= 1,
            ";" if depth == 0 => return at + 1,
            _ => continue,
        }
        if depth <= 0 {
            return at + 1;
        }
    }
    tokens.len()
}
