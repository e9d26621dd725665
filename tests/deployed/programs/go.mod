module deployed

go 1.21
