# What includes what, against the layer table of src/README.md.
add_test(NAME structure.includes COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/structure/test_includes.py ${PROJECT_SOURCE_DIR})
# No option keeps a value that another configuration of the same folder gave it.
add_test(NAME structure.presets COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/structure/test_presets.py ${PROJECT_SOURCE_DIR})
# What a test reads that a clone has not is named.
add_test(NAME structure.data COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/structure/test_data.py ${PROJECT_SOURCE_DIR})
# As `make format` leaves them. Each release breaks some lines otherwise, so one of them is the measure; others skip.
find_program(MIRAGE_CLANG_FORMAT NAMES clang-format-14 clang-format)
set(found "")
if(MIRAGE_CLANG_FORMAT)
  execute_process(COMMAND ${MIRAGE_CLANG_FORMAT} --version OUTPUT_VARIABLE found OUTPUT_STRIP_TRAILING_WHITESPACE)
endif()
if(MIRAGE_CLANG_FORMAT AND NOT found MATCHES "version 14\\.")
  add_test(NAME structure.format COMMAND sh -c "echo 'skipped: clang-format 14 is the measure; there is ${found}'; exit 77")
  set_tests_properties(structure.format PROPERTIES SKIP_RETURN_CODE 77)
elseif(MIRAGE_CLANG_FORMAT)
  file(GLOB_RECURSE formatted CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/src/*.h ${PROJECT_SOURCE_DIR}/src/*.cpp
       ${PROJECT_SOURCE_DIR}/plugins/*.h ${PROJECT_SOURCE_DIR}/plugins/*.cpp ${PROJECT_SOURCE_DIR}/validation/*.h
       ${PROJECT_SOURCE_DIR}/validation/*.cpp ${PROJECT_SOURCE_DIR}/tests/*.h ${PROJECT_SOURCE_DIR}/tests/*.cpp)
  add_test(NAME structure.format COMMAND ${MIRAGE_CLANG_FORMAT} --dry-run --Werror ${formatted})
endif()
# clang-tidy on the lines that changed. A sanitizer's build has flags that clang reads otherwise.
find_program(MIRAGE_CLANG_TIDY clang-tidy)
if(MIRAGE_CLANG_TIDY AND NOT MIRAGE_SANITIZE)
  add_test(NAME structure.tidy COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/structure/test_tidy.py ${PROJECT_SOURCE_DIR} ${CMAKE_BINARY_DIR})
  set_tests_properties(structure.tidy PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 1200)
endif()
# Every public member says what it is. `make docs` installs Doxygen; `make setup` does not.
if(MIRAGE_DOXYGEN)
  add_test(NAME structure.documentation COMMAND ${MIRAGE_DOXYGEN} ${PROJECT_BINARY_DIR}/src/packaging/Doxyfile)
else()
  add_test(NAME structure.documentation COMMAND sh -c "echo 'skipped: doxygen is missing (apt-get install doxygen)'; exit 77")
endif()
set_tests_properties(structure.documentation PROPERTIES SKIP_RETURN_CODE 77)
mirage_python_test(structure.blas structure/test_blas.py)
