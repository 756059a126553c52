# The pages (*.md) against the repository: links, files, options of commands, names of tests. No browser, no data.
add_test(NAME pages COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/pages/test_pages.py ${PROJECT_SOURCE_DIR}
                            ${CMAKE_BINARY_DIR})
