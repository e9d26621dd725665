package brain

import (
	"go/ast"
	"go/importer"
	"go/parser"
	"go/token"
	"go/types"
	"os"
	"slices"
	"strings"
	"testing"
)

// TestEveryProductIsRoundedByItself holds the sources to the rule by which no compiler may fuse a product with a sum.
func TestEveryProductIsRoundedByItself(t *testing.T) {
	for _, folder := range []string{".", "../genome", "../internal/elementary", "../internal/random"} {
		files := token.NewFileSet()
		sources := []*ast.File{}
		entries, err := os.ReadDir(folder)
		if err != nil {
			t.Fatal(err)
		}
		for _, entry := range entries {
			if !strings.HasSuffix(entry.Name(), ".go") || strings.HasSuffix(entry.Name(), "_test.go") {
				continue
			}
			source, err := parser.ParseFile(files, folder+"/"+entry.Name(), nil, 0)
			if err != nil {
				t.Fatal(err)
			}
			sources = append(sources, source)
		}
		if products := unroundedProducts(files, sources); len(products) > 0 {
			t.Errorf("products that are not rounded by themselves, float64(a*b): %v", products)
		}
	}
}

// unroundedProducts returns where products of floating point stand that no conversion rounds.
func unroundedProducts(files *token.FileSet, sources []*ast.File) (found []string) {
	info := &types.Info{Types: map[ast.Expr]types.TypeAndValue{}}
	config := types.Config{Importer: importer.ForCompiler(files, "source", nil), Error: func(error) {}}
	_, _ = config.Check("brain", files, sources, info) // what it does not know counts as floating point
	whole := func(expression ast.Expr) bool {
		known := info.Types[expression]
		if known.Value != nil {
			return true // a constant
		}
		basic, is := known.Type.(*types.Basic)
		return is && basic.Info()&types.IsInteger != 0
	}
	for _, source := range sources {
		rounded := []ast.Expr{}
		ast.Inspect(source, func(node ast.Node) bool {
			switch node := node.(type) {
			case *ast.CallExpr:
				if name, is := node.Fun.(*ast.Ident); is && name.Name == "float64" {
					rounded = append(rounded, node.Args[0])
				}
			case *ast.BinaryExpr:
				if node.Op == token.MUL && !whole(node) && !slices.Contains(rounded, ast.Expr(node)) {
					found = append(found, files.Position(node.Pos()).String())
				}
			case *ast.AssignStmt:
				if node.Tok == token.MUL_ASSIGN && !whole(node.Lhs[0]) {
					found = append(found, files.Position(node.Pos()).String())
				}
			}
			return true
		})
	}
	return found
}

func TestAnUnroundedProductIsFound(t *testing.T) {
	for text, wanted := range map[string]int{
		"return x + y*z": 1, "p := y * z; return x + p": 1, "x *= y; return x + z": 1, "return x + float64(y)*z": 1,
		"return x + float64(y*z)": 0, "return float64(float64(x*y)*z) + x": 0, "n := 2; return x + float64(n*n)": 0, "return 2 * 3": 0,
	} {
		files := token.NewFileSet()
		source, err := parser.ParseFile(files, "x.go", "package x; func f(x, y, z float64) float64 { "+text+" }", 0)
		if err != nil {
			t.Fatal(err)
		}
		if found := unroundedProducts(files, []*ast.File{source}); len(found) != wanted {
			t.Errorf("%s: %v", text, found)
		}
	}
}
