//! Paths among tokens that no grammar is known for: the arguments of macros and attributes.

use proc_macro2::{TokenStream, TokenTree};

use super::RustPath;

/// The words of a stream, those joined by `::` together, in the order of the text. What is asked
/// of a value, after a dot, is none.
pub fn paths(stream: TokenStream) -> Vec<RustPath> {
    let trees: Vec<TokenTree> = stream.into_iter().collect();
    let is =
        |at: usize, sign| matches!(trees.get(at), Some(TokenTree::Punct(p)) if p.as_char() == sign);
    let (mut found, mut at) = (Vec::new(), 0);
    while let Some(tree) = trees.get(at) {
        at += 1;
        match tree {
            TokenTree::Group(group) => found.extend(paths(group.stream())),
            TokenTree::Ident(word) => {
                let of_value = at >= 2 && is(at - 2, '.') && !(at >= 3 && is(at - 3, '.'));
                let line = word.span().start().line;
                let mut segments = vec![word.to_string()];
                while is(at, ':') && is(at + 1, ':') {
                    let Some(TokenTree::Ident(next)) = trees.get(at + 2) else {
                        break;
                    };
                    segments.push(next.to_string());
                    at += 3;
                }
                if !of_value {
                    found.push(RustPath { line, segments });
                }
            }
            TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
    }
    found
}
