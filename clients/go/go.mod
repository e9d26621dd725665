// The path is a placeholder: it is replaced here, and nowhere else, when the module is published.
module nmes

go 1.24
