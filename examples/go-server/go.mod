module nmes.example/server

go 1.21
