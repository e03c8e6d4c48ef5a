//! The suite calls every method of the store, and opens its stores in one place.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Expr, ExprCall, ExprMethodCall, ImplItem, Item, ItemImpl, Type, Visibility};

use crate::sources::{Sources, arguments_of, is_for_tests, sources};
use crate::statements::COMPOSED;

/// Methods that the service does not need: tests read a whole route with them.
const FOR_TESTS_ALONE: [&str; 5] = ["active_nodes", "edges", "nodes", "trajectory", "trip_nodes"];

/// Files that use SQL past the store, each for what is said in its head. All others hold for any
/// backend.
const ABOUT_SQLITE: [&str; 14] = [
    "archive.rs",
    "audit.rs",
    "between.rs",
    "consistency.rs",
    "graph.rs",
    "journal.rs",
    "keys.rs",
    "lost.rs",
    "names.rs",
    "rot.rs",
    "settled.rs",
    "statements.rs",
    "tiers.rs",
    "webhooks.rs",
];

/// The public asynchronous methods of `Store`, each with its file.
fn methods(files: &Sources) -> BTreeMap<String, String> {
    let mut methods = BTreeMap::new();
    for (name, file) in files {
        let blocks = file.items.iter().filter_map(|item| match item {
            Item::Impl(block) if is_of_store(block) => Some(block),
            _ => None,
        });
        for item in blocks.flat_map(|block| &block.items) {
            if let ImplItem::Fn(method) = item
                && method.sig.asyncness.is_some()
                && matches!(method.vis, Visibility::Public(_))
            {
                methods.insert(method.sig.ident.to_string(), name.clone());
            }
        }
    }
    methods
}

fn is_of_store(block: &ItemImpl) -> bool {
    let Type::Path(path) = &*block.self_ty else {
        return false;
    };
    block.trait_.is_none() && path.path.is_ident("Store")
}

/// What files ask of a store.
#[derive(Default)]
struct Calls {
    /// Methods of values called `store`, and functions of `Store`.
    methods: BTreeSet<String>,
    /// Functions of no type.
    functions: BTreeSet<String>,
    /// Whether code that is compiled for tests alone is left out.
    skips_tests: bool,
    /// Whether `self` is a store here.
    is_store: bool,
}

impl Calls {
    fn of(files: &Sources) -> Self {
        let mut calls = Self::default();
        files.values().for_each(|file| calls.visit_file(file));
        calls
    }

    /// What the service calls: code that is compiled for tests alone is left out.
    fn of_service() -> Self {
        let mut calls = Self {
            skips_tests: true,
            ..Self::default()
        };
        let files = sources("src");
        files.values().for_each(|file| calls.visit_file(file));
        calls
    }

    /// The calls among tokens that are no list of arguments.
    fn add_tokens(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        for four in tokens.windows(4) {
            if let [
                TokenTree::Ident(store),
                TokenTree::Punct(dot),
                TokenTree::Ident(name),
                TokenTree::Group(_),
            ] = four
                && store == "store"
                && dot.as_char() == '.'
            {
                self.methods.insert(name.to_string());
            }
        }
        for token in tokens {
            if let TokenTree::Group(group) = token {
                self.add_tokens(group.stream());
            }
        }
    }
}

/// Whether an expression is a value called `store`, perhaps a part or a clone of something.
fn is_a_store(expression: &Expr) -> bool {
    match expression {
        Expr::Field(field) => matches!(&field.member, syn::Member::Named(name) if name == "store"),
        Expr::Path(path) => path
            .path
            .segments
            .last()
            .is_some_and(|last| last.ident == "store"),
        Expr::MethodCall(call) if call.method == "clone" => is_a_store(&call.receiver),
        Expr::Reference(reference) => is_a_store(&reference.expr),
        Expr::Paren(paren) => is_a_store(&paren.expr),
        _ => false,
    }
}

impl<'ast> Visit<'ast> for Calls {
    fn visit_item(&mut self, item: &'ast Item) {
        let is_left_out = matches!(item, Item::Mod(module) if is_for_tests(&module.attrs));
        if !(self.skips_tests && is_left_out) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_impl(&mut self, block: &'ast ItemImpl) {
        self.is_store = is_of_store(block);
        visit::visit_item_impl(self, block);
        self.is_store = false;
    }

    fn visit_expr_method_call(&mut self, call: &'ast ExprMethodCall) {
        let is_itself = matches!(&*call.receiver, Expr::Path(path) if path.path.is_ident("self"));
        if is_a_store(&call.receiver) || (self.is_store && is_itself) {
            self.methods.insert(call.method.to_string());
        }
        visit::visit_expr_method_call(self, call);
    }

    fn visit_expr_call(&mut self, call: &'ast ExprCall) {
        if let Expr::Path(function) = &*call.func {
            let names = function.path.segments.iter().map(|s| s.ident.to_string());
            match names.collect::<Vec<_>>().as_slice() {
                [name] => {
                    self.functions.insert(name.clone());
                }
                [.., of, name] if of == "Store" => {
                    self.methods.insert(name.clone());
                }
                _ => {}
            }
        }
        visit::visit_expr_call(self, call);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        match arguments_of(call) {
            Some(arguments) => {
                for argument in &arguments {
                    self.visit_expr(argument);
                }
            }
            None => self.add_tokens(call.tokens.clone()),
        }
    }
}

fn suite() -> Sources {
    sources("tests/store")
}

#[test]
fn a_test_calls_every_method_of_the_store() {
    let calls = Calls::of(&suite());
    let methods = methods(&sources("src/store"));
    let is_uncalled = |(method, _): &(&String, &String)| !calls.methods.contains(*method);
    let uncalled = methods.iter().filter(is_uncalled);
    let uncalled: Vec<String> = uncalled
        .map(|(method, file)| format!("{file}: {method}"))
        .collect();
    assert!(
        uncalled.is_empty(),
        "no test calls\n{}",
        uncalled.join("\n")
    );
    assert!(
        methods.len() > 80,
        "only {} methods were found",
        methods.len()
    );
}

#[test]
fn a_test_executes_what_is_composed() {
    let calls = Calls::of(&suite());
    for (file, count, by) in COMPOSED {
        assert!(!by.is_empty(), "{file}: {count}");
        for method in by {
            let is_called = calls.methods.contains(*method) || calls.functions.contains(*method);
            assert!(is_called, "{file}: {method}");
        }
    }
}

#[test]
fn methods_that_the_service_does_not_call_are_in_the_list() {
    let calls = Calls::of_service();
    let methods = methods(&sources("src/store")).into_keys();
    let uncalled: Vec<String> = methods
        .filter(|method| !calls.methods.contains(method))
        .collect();
    assert_eq!(uncalled, FOR_TESTS_ALONE);
}

#[test]
fn the_suite_opens_stores_in_one_place_and_says_what_is_about_sqlite() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/store");
    for name in suite().keys() {
        let text = std::fs::read_to_string(root.join(name)).unwrap();
        if !["main.rs", "support.rs", "coverage.rs"].contains(&name.as_str()) {
            assert!(
                !text.contains("StoreOptions {"),
                "{name} opens a store itself"
            );
            let uses_sql = text.contains("sqlx::") || text.contains(".raw()");
            let is_listed = ABOUT_SQLITE.contains(&name.as_str());
            assert_eq!(uses_sql, is_listed, "{name}");
            let head = text.lines().take_while(|line| line.starts_with("//!"));
            let says_so = head.into_iter().any(|line| line.contains("SQLite"));
            assert_eq!(says_so, is_listed, "{name}: its head");
        }
    }
}

#[test]
fn a_planted_method_is_missed() {
    let parsed = |text| BTreeMap::from([("a.rs".to_owned(), syn::parse_file(text).unwrap())]);
    let store = parsed(
        "impl Store { pub async fn a(&self) {} pub fn b(&self) {} async fn c(&self) {} }
         impl Request for Store { async fn d(&self) {} } impl Other { pub async fn e(&self) {} }",
    );
    let found: Vec<String> = methods(&store).into_keys().collect();
    assert_eq!(found, ["a"]);
    for (test, calls) in [
        ("fn f() { store.a().await }", true),
        (
            "fn f() { assert_eq!(fixture.store.a().await.unwrap(), 1) }",
            true,
        ),
        ("fn f() { let a = (&store).clone().a(); }", true),
        ("fn f() { Store::a(&fixture).await }", true),
        ("fn f() { fixture.a().await }", false),
        ("fn f() { store.b().a().await; // store.a()\n }", false),
        ("fn f() { a(&store) }", false),
        ("fn a() {}", false),
    ] {
        assert_eq!(
            Calls::of(&parsed(test)).methods.contains("a"),
            calls,
            "{test}"
        );
    }
    let mut service = Calls {
        skips_tests: true,
        ..Calls::default()
    };
    for file in [
        "#[cfg(test)] mod tests { fn f() { store.a() } }",
        "fn f() { tokio::select! { () = store.b() => {} } }",
    ] {
        service.visit_file(&syn::parse_file(file).unwrap());
    }
    assert_eq!(service.methods, BTreeSet::from(["b".to_owned()]));
}
