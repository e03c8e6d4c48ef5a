//! The SQL texts of a source file, read with `syn`.

use std::collections::BTreeMap;

use proc_macro2::{Group, Literal, Spacing, Span, TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, Expr, ExprCall, File, Item, Lit, Macro};

use crate::sources::{arguments_of, is_for_tests};

/// Words that a statement begins with.
const VERBS: [&str; 20] = [
    "ALTER",
    "ANALYZE",
    "ATTACH",
    "BEGIN",
    "COMMIT",
    "CREATE",
    "DELETE",
    "DETACH",
    "DROP",
    "INSERT",
    "PRAGMA",
    "REINDEX",
    "RELEASE",
    "REPLACE",
    "ROLLBACK",
    "SAVEPOINT",
    "SELECT",
    "UPDATE",
    "VACUUM",
    "WITH",
];

/// The functions of `sqlx` that take a whole statement.
const WHOLE: [&str; 4] = ["query", "query_as", "query_scalar", "raw_sql"];

/// A text of the source after all `concat!`s and macros of the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Text {
    /// Where it begins, from 1.
    pub line: usize,
    pub sql: String,
}

/// What a file gives to `sqlx`, outside its test code.
#[derive(Default)]
pub struct Texts {
    /// Whole statements.
    pub statements: Vec<Text>,
    /// Pieces that a `QueryBuilder` is made of or pushes.
    pub pieces: Vec<Text>,
    /// Statements that are composed while the program runs: each `QueryBuilder::new` and
    /// `AssertSqlSafe`.
    pub composed: usize,
    /// Macros that hold SQL and were not understood, by line.
    pub unread: Vec<usize>,
}

/// The `macro_rules!` of the store by name; a rule whose parameters are not plain is left out.
#[derive(Default)]
pub struct Macros(BTreeMap<String, Vec<Rule>>);

/// `($a:literal, $b:expr) => { … }`.
struct Rule {
    parameters: Vec<String>,
    body: TokenStream,
}

impl Macros {
    /// Adds the rules that a file defines.
    pub fn add(&mut self, file: &File) {
        for item in &file.items {
            if let Item::Macro(definition) = item
                && let Some(name) = &definition.ident
            {
                let rules = rules_of(definition.mac.tokens.clone());
                self.0.insert(name.to_string(), rules);
            }
        }
    }

    /// The text that an expression is, if it is one.
    fn text_of(&self, expression: &Expr) -> Option<String> {
        match expression {
            Expr::Lit(literal) => match &literal.lit {
                Lit::Str(text) => Some(text.value()),
                Lit::Int(number) => Some(number.base10_digits().to_owned()),
                _ => None,
            },
            Expr::Group(group) => self.text_of(&group.expr),
            Expr::Paren(paren) => self.text_of(&paren.expr),
            Expr::Macro(call) => self.expanded(&call.mac),
            _ => None,
        }
    }

    fn expanded(&self, call: &Macro) -> Option<String> {
        let name = call.path.segments.last()?.ident.to_string();
        let arguments = arguments_of(call)?;
        let texts = arguments.iter().map(|argument| self.text_of(argument));
        let texts: Option<Vec<String>> = texts.collect();
        if name == "concat" {
            return Some(texts?.concat());
        }
        let (texts, rules) = (texts?, self.0.get(&name)?);
        let fits = |rule: &&Rule| rule.parameters.len() == texts.len();
        let rule = rules.iter().find(fits)?;
        let values = rule.parameters.iter().cloned().zip(texts).collect();
        let body = substituted(rule.body.clone(), &values);
        self.text_of(&syn::parse2(body).ok()?)
    }
}

/// The rules of a `macro_rules!`: matchers and bodies by turns.
fn rules_of(tokens: TokenStream) -> Vec<Rule> {
    let mut groups = tokens.into_iter().filter_map(|token| match token {
        TokenTree::Group(group) => Some(group.stream()),
        _ => None,
    });
    let mut rules = Vec::new();
    while let (Some(matcher), Some(body)) = (groups.next(), groups.next()) {
        rules.extend(parameters_of(matcher).map(|parameters| Rule { parameters, body }));
    }
    rules
}

/// The names in `$a:literal, $b:expr`; `None` for anything that is not of this form.
fn parameters_of(matcher: TokenStream) -> Option<Vec<String>> {
    let tokens: Vec<TokenTree> = matcher.into_iter().collect();
    let parameters = tokens.split(|token| is_sign(token, ','));
    let parameters = parameters.filter(|parameter| !parameter.is_empty());
    let name = |parameter: &[TokenTree]| match parameter {
        [dollar, TokenTree::Ident(name), colon, TokenTree::Ident(_)]
            if is_sign(dollar, '$') && is_sign(colon, ':') =>
        {
            Some(name.to_string())
        }
        _ => None,
    };
    parameters.map(name).collect()
}

fn is_sign(token: &TokenTree, sign: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == sign && punct.spacing() == Spacing::Alone)
}

/// The body of a rule with texts for its parameters.
fn substituted(body: TokenStream, values: &BTreeMap<String, String>) -> TokenStream {
    let mut tokens = body.into_iter().peekable();
    let mut done = Vec::new();
    while let Some(token) = tokens.next() {
        let value = match (is_sign(&token, '$'), tokens.peek()) {
            (true, Some(TokenTree::Ident(name))) => values.get(&name.to_string()),
            _ => None,
        };
        done.push(match (value, token) {
            (Some(value), _) => {
                tokens.next();
                TokenTree::Literal(Literal::string(value))
            }
            (None, TokenTree::Group(group)) => {
                let inner = substituted(group.stream(), values);
                TokenTree::Group(Group::new(group.delimiter(), inner))
            }
            (None, token) => token,
        });
    }
    done.into_iter().collect()
}

impl Texts {
    /// Reads a file with the macros that it may use.
    pub fn of(file: &File, macros: &Macros) -> Self {
        let mut reader = Reader {
            macros,
            texts: Self::default(),
        };
        reader.visit_file(file);
        reader.texts
    }
}

struct Reader<'a> {
    macros: &'a Macros,
    texts: Texts,
}

impl Reader<'_> {
    fn text(&self, expression: &Expr) -> Option<Text> {
        let sql = self.macros.text_of(expression)?;
        let line = span_of(expression).start().line;
        Some(Text { line, sql })
    }
}

/// Where an expression that is a text begins.
fn span_of(expression: &Expr) -> Span {
    match expression {
        Expr::Lit(literal) => literal.lit.span(),
        Expr::Macro(call) => call.mac.bang_token.span,
        Expr::Group(group) => span_of(&group.expr),
        Expr::Paren(paren) => span_of(&paren.expr),
        _ => Span::call_site(),
    }
}

fn begins_a_statement(text: &str) -> bool {
    let mut words = text.split(|c: char| !c.is_ascii_alphabetic());
    VERBS.contains(&words.find(|word| !word.is_empty()).unwrap_or_default())
        && text
            .trim_start()
            .starts_with(|c: char| c.is_ascii_uppercase())
}

/// The last two names of a function that is called.
fn function_of(call: &ExprCall) -> Option<(String, String)> {
    let Expr::Path(path) = &*call.func else {
        return None;
    };
    let mut names = path.path.segments.iter().rev().map(|s| s.ident.to_string());
    Some((names.next()?, names.next().unwrap_or_default()))
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        match item {
            Item::Mod(module) if is_for_tests(&module.attrs) => {}
            Item::Fn(function) if is_for_tests(&function.attrs) => {}
            Item::Impl(block) if is_for_tests(&block.attrs) => {}
            Item::Macro(_) => {}
            _ => visit::visit_item(self, item),
        }
    }

    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        if !is_for_tests(&function.attrs) {
            visit::visit_impl_item_fn(self, function);
        }
    }

    fn visit_expr(&mut self, expression: &'ast Expr) {
        match self.text(expression) {
            Some(text) if begins_a_statement(&text.sql) => self.texts.statements.push(text),
            Some(_) => {}
            None => visit::visit_expr(self, expression),
        }
    }

    fn visit_expr_call(&mut self, call: &'ast ExprCall) {
        let Some((name, of)) = function_of(call) else {
            return visit::visit_expr_call(self, call);
        };
        let text = call.args.first().and_then(|text| self.text(text));
        match (name.as_str(), text) {
            ("AssertSqlSafe", _) => self.texts.composed += 1,
            ("new", text) if of == "QueryBuilder" => {
                self.texts.composed += 1;
                self.texts.pieces.extend(text);
            }
            (name, Some(text)) if WHOLE.contains(&name) => self.texts.statements.push(text),
            _ => visit::visit_expr_call(self, call),
        }
    }

    fn visit_expr_method_call(&mut self, call: &'ast syn::ExprMethodCall) {
        if call.method == "push" {
            let text = call.args.first().and_then(|text| self.text(text));
            self.texts.pieces.extend(text);
        }
        visit::visit_expr_method_call(self, call);
    }

    fn visit_macro(&mut self, call: &'ast Macro) {
        // What is formatted is composed, and goes through `AssertSqlSafe`.
        if call.path.is_ident("format") {
            return;
        }
        match arguments_of(call) {
            Some(arguments) => {
                for argument in &arguments {
                    self.visit_expr(argument);
                }
            }
            None if holds_sql(call.tokens.clone()) => {
                self.texts.unread.push(call.bang_token.span.start().line);
            }
            None => {}
        }
    }

    fn visit_attribute(&mut self, _: &'ast Attribute) {}
}

fn holds_sql(tokens: TokenStream) -> bool {
    tokens.into_iter().any(|token| match token {
        TokenTree::Group(group) => holds_sql(group.stream()),
        TokenTree::Literal(literal) => match Lit::new(literal) {
            Lit::Str(text) => begins_a_statement(&text.value()),
            _ => false,
        },
        _ => false,
    })
}
