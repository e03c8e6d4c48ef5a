//! How large the crate is.

use std::fmt;
use std::ops::AddAssign;

use proc_macro2::{Span, TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Item, LitStr, Visibility};

use super::reader::{is_for_tests, outside};

/// Words that SQL statements begin with.
const SQL: [&str; 8] = [
    "SELECT ", "INSERT ", "UPDATE ", "DELETE ", "WITH ", "PRAGMA ", "BEGIN", "VACUUM",
];

/// What a file holds outside its test code.
#[derive(Default)]
pub struct Figures {
    /// Functions, types, traits and constants that are `pub` without restriction.
    pub public_items: usize,
    /// Those for a part of the crate: `pub(crate)`, `pub(super)`.
    pub shared_items: usize,
    /// Lines of the longest function, and its name.
    pub longest_function: (usize, String),
    /// Texts that are SQL statements.
    pub sql_statements: usize,
}

impl Figures {
    /// Counts in the text of a file.
    pub fn of(text: &str) -> Self {
        let mut figures = Self::default();
        figures.visit_file(&syn::parse_file(text).unwrap());
        figures
    }

    fn add_item(&mut self, visibility: &Visibility) {
        match visibility {
            Visibility::Public(_) => self.public_items += 1,
            Visibility::Restricted(_) => self.shared_items += 1,
            Visibility::Inherited => {}
        }
    }

    fn add_function(&mut self, name: &syn::Ident, from: Span, to: Span) {
        let lines = to.end().line - from.start().line + 1;
        let function = (lines, name.to_string());
        self.longest_function = function.max(std::mem::take(&mut self.longest_function));
    }

    fn add_text(&mut self, text: &LitStr) {
        let text = text.value();
        let begins = |word: &&str| text.trim_start().starts_with(*word);
        self.sql_statements += usize::from(SQL.iter().any(begins));
    }

    fn add_texts(&mut self, stream: TokenStream) {
        for tree in stream {
            match tree {
                TokenTree::Group(group) => self.add_texts(group.stream()),
                TokenTree::Literal(literal) => {
                    if let syn::Lit::Str(text) = syn::Lit::new(literal) {
                        self.add_text(&text);
                    }
                }
                TokenTree::Ident(_) | TokenTree::Punct(_) => {}
            }
        }
    }
}

impl AddAssign for Figures {
    fn add_assign(&mut self, other: Self) {
        self.public_items += other.public_items;
        self.shared_items += other.shared_items;
        self.sql_statements += other.sql_statements;
        let longest = std::mem::take(&mut self.longest_function);
        self.longest_function = longest.max(other.longest_function);
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (lines, name) = &self.longest_function;
        write!(
            f,
            "public items {}, shared items {}, longest function {lines} lines ({name}), SQL {}",
            self.public_items, self.shared_items, self.sql_statements
        )
    }
}

impl<'ast> Visit<'ast> for Figures {
    fn visit_item(&mut self, item: &'ast Item) {
        if is_for_tests(outside(item).0) {
            return;
        }
        match item {
            Item::Const(i) => self.add_item(&i.vis),
            Item::Enum(i) => self.add_item(&i.vis),
            Item::Fn(i) => {
                self.add_item(&i.vis);
                let brace = i.block.brace_token.span.close();
                self.add_function(&i.sig.ident, i.sig.fn_token.span, brace);
            }
            Item::Static(i) => self.add_item(&i.vis),
            Item::Struct(i) => self.add_item(&i.vis),
            Item::Trait(i) => self.add_item(&i.vis),
            Item::Type(i) => self.add_item(&i.vis),
            _ => {}
        }
        visit::visit_item(self, item);
    }

    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        if !is_for_tests(&function.attrs) {
            self.add_item(&function.vis);
            let brace = function.block.brace_token.span.close();
            let start = function.sig.fn_token.span;
            self.add_function(&function.sig.ident, start, brace);
            visit::visit_impl_item_fn(self, function);
        }
    }

    fn visit_impl_item_const(&mut self, constant: &'ast syn::ImplItemConst) {
        self.add_item(&constant.vis);
        visit::visit_impl_item_const(self, constant);
    }

    fn visit_lit_str(&mut self, text: &'ast LitStr) {
        self.add_text(text);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.add_texts(call.tokens.clone());
    }

    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
}
