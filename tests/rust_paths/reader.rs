//! One walk over the syntax of a file.

use std::collections::BTreeMap;
use std::path::PathBuf;

use proc_macro2::Ident;
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree, Visibility};

use super::{Import, RustPath, Source, tokens};

/// Reads the file of a module.
pub fn read(module: Vec<String>, file: &syn::File) -> Source {
    let mut reader = Reader {
        source: Source {
            module,
            imports: Vec::new(),
            code: Vec::new(),
            items: BTreeMap::new(),
            test_modules: Vec::new(),
        },
    };
    reader.visit_file(file);
    reader.source
}

struct Reader {
    source: Source,
}

/// Whether one of the attributes is `#[cfg(test)]`.
pub fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute
                .parse_args::<Ident>()
                .is_ok_and(|word| word == "test")
    })
}

/// The attributes of an item, the name under which others find it, and whether it is a trait.
pub fn outside(item: &Item) -> (&[Attribute], Option<&Ident>, bool) {
    match item {
        Item::Const(i) => (&i.attrs, Some(&i.ident), false),
        Item::Enum(i) => (&i.attrs, Some(&i.ident), false),
        Item::Fn(i) => (&i.attrs, Some(&i.sig.ident), false),
        Item::Impl(i) => (&i.attrs, None, false),
        Item::Macro(i) => (&i.attrs, i.ident.as_ref(), false),
        Item::Mod(i) => (&i.attrs, None, false),
        Item::Static(i) => (&i.attrs, Some(&i.ident), false),
        Item::Struct(i) => (&i.attrs, Some(&i.ident), false),
        Item::Trait(i) => (&i.attrs, Some(&i.ident), true),
        Item::Type(i) => (&i.attrs, Some(&i.ident), false),
        Item::Union(i) => (&i.attrs, Some(&i.ident), false),
        Item::Use(i) => (&i.attrs, None, false),
        _ => (&[], None, false),
    }
}

impl Reader {
    fn add(&mut self, line: usize, segments: Vec<String>) {
        let path = self.resolved(line, segments);
        self.source.code.push(path);
    }

    fn add_all(&mut self, paths: Vec<RustPath>) {
        for RustPath { line, segments } in paths {
            self.add(line, segments);
        }
    }

    /// The path with `crate` and the module's own names for what `self` and `super`s mean.
    fn resolved(&self, line: usize, mut segments: Vec<String>) -> RustPath {
        let module = &self.source.module;
        let own = usize::from(segments[0] == "self");
        let supers = segments[own..].iter().take_while(|s| *s == "super").count();
        if segments.len() > own + supers && own + supers > 0 {
            let left = &module[..module.len().saturating_sub(supers)];
            let root = std::iter::once("crate".to_owned()).chain(left.iter().cloned());
            segments.splice(..own + supers, root);
        }
        RustPath { line, segments }
    }

    fn import(&mut self, tree: &UseTree, prefix: &[String], public: bool) {
        let with = |name: &Ident| {
            let mut segments = prefix.to_vec();
            if name != "self" || prefix.is_empty() {
                segments.push(name.to_string());
            }
            segments
        };
        let (name, line, segments) = match tree {
            UseTree::Path(path) => return self.import(&path.tree, &with(&path.ident), public),
            UseTree::Group(group) => {
                for tree in &group.items {
                    self.import(tree, prefix, public);
                }
                return;
            }
            UseTree::Name(name) => (
                with(&name.ident).pop().unwrap(),
                name.ident.span().start().line,
                with(&name.ident),
            ),
            UseTree::Rename(name) => (
                name.rename.to_string(),
                name.rename.span().start().line,
                with(&name.ident),
            ),
            UseTree::Glob(glob) => (
                "*".to_owned(),
                glob.star_token.spans[0].start().line,
                [prefix, &["*".to_owned()]].concat(),
            ),
        };
        let path = self.resolved(line, segments);
        self.source.imports.push(Import { name, path, public });
    }
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_item(&mut self, item: &'ast Item) {
        let (attributes, name, is_trait) = outside(item);
        if !is_for_tests(attributes) {
            let name = name.map(|name| (name.to_string(), is_trait));
            self.source.items.extend(name);
            visit::visit_item(self, item);
        } else if let Item::Mod(module) = item
            && module.content.is_none()
        {
            let directory: PathBuf = self.source.module.iter().collect();
            let file = directory.join(module.ident.to_string());
            self.source.test_modules.push(file);
        }
    }

    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        if !is_for_tests(&function.attrs) {
            visit::visit_impl_item_fn(self, function);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        let public = !matches!(item.vis, Visibility::Inherited);
        self.import(&item.tree, &[], public);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments = path.segments.iter().map(|s| s.ident.to_string()).collect();
        self.add(path.segments[0].ident.span().start().line, segments);
        visit::visit_path(self, path);
    }

    /// A pattern of one word may be a constant.
    fn visit_pat_ident(&mut self, pattern: &'ast syn::PatIdent) {
        let word = pattern.ident.to_string();
        if word.starts_with(char::is_uppercase) {
            self.add(pattern.ident.span().start().line, vec![word]);
        }
        visit::visit_pat_ident(self, pattern);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.add_all(tokens::paths(call.tokens.clone()));
        visit::visit_macro(self, call);
    }

    fn visit_meta_list(&mut self, list: &'ast syn::MetaList) {
        self.add_all(tokens::paths(list.tokens.clone()));
        visit::visit_meta_list(self, list);
    }

    /// `pub(crate)` names no module.
    fn visit_visibility(&mut self, _: &'ast Visibility) {}
}
