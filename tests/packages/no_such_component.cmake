find_package(Mirage REQUIRED COMPONENTS magic)
