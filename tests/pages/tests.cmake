# The pages (*.md) against the repository: links, files, options of commands, names of tests, words. No browser, no data.
add_test(NAME pages COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/pages/test_pages.py ${PROJECT_SOURCE_DIR}
                            ${CMAKE_BINARY_DIR})
# Pages that programs write, against what they would write: commands from --help, tables and plots from validation/results.
add_test(NAME pages.reference COMMAND ${MIRAGE_TEST_PYTHON} -B ${PROJECT_SOURCE_DIR}/src/guide/reference.py $<TARGET_FILE:mirage>
                                      ${PROJECT_SOURCE_DIR}/src/guide/commands.md --check)
add_test(NAME pages.evidence COMMAND ${MIRAGE_TEST_PYTHON} -B ${PROJECT_SOURCE_DIR}/src/guide/evidence.py ${PROJECT_SOURCE_DIR} --check)
# The site in headless Chromium; skipped with a message where Chromium or mkdocs is missing.
add_test(NAME pages.site COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/pages/test_site.py ${PROJECT_SOURCE_DIR}
                                 ${CMAKE_BINARY_DIR})
set_tests_properties(pages.site PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 900)
