# What includes what, against the layer table of src/README.md.
add_test(NAME structure.includes COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/structure/test_includes.py ${PROJECT_SOURCE_DIR})
# As `make format` leaves them.
find_program(MIRAGE_CLANG_FORMAT clang-format)
if(MIRAGE_CLANG_FORMAT)
  file(GLOB_RECURSE formatted CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/src/*.h ${PROJECT_SOURCE_DIR}/src/*.cpp
       ${PROJECT_SOURCE_DIR}/plugins/*.h ${PROJECT_SOURCE_DIR}/plugins/*.cpp ${PROJECT_SOURCE_DIR}/validation/*.h
       ${PROJECT_SOURCE_DIR}/validation/*.cpp ${PROJECT_SOURCE_DIR}/tests/*.h ${PROJECT_SOURCE_DIR}/tests/*.cpp)
  add_test(NAME structure.format COMMAND ${MIRAGE_CLANG_FORMAT} --dry-run --Werror ${formatted})
endif()
# What no test runs.
add_test(NAME structure.compiles COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/structure/test_compiles.py ${CMAKE_BINARY_DIR}
         ${PROJECT_SOURCE_DIR}/validation/benchmarks ${PROJECT_SOURCE_DIR}/validation/studies)
