module nmes.example/arm

go 1.21
