# The report of mirage validate in headless Chromium; skipped with a message where Chromium is missing.
add_test(NAME report.page COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/report/test_report.py
                                  ${PROJECT_SOURCE_DIR} ${CMAKE_BINARY_DIR})
set_tests_properties(report.page PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 600)
# The page of mirage reproduce.
add_test(NAME report.paper COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/report/test_paper_page.py
                                   ${PROJECT_SOURCE_DIR})
set_tests_properties(report.paper PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 600)
# Their files on a full disk.
add_test(NAME report.files COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/report/test_atomic.py
                                   ${PROJECT_SOURCE_DIR})
# The page of mirage drive.
add_test(NAME report.drive COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/report/test_drive_page.py
                                   ${PROJECT_SOURCE_DIR})
set_tests_properties(report.drive PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 600)
# The pages of mirage audit, mirage compare and mirage score.
add_test(NAME report.decisions COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/report/test_decision_pages.py
                                       ${PROJECT_SOURCE_DIR})
set_tests_properties(report.decisions PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 600)
# What mirage export --kit writes.
add_test(NAME report.kit COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/report/test_kit.py
                                 ${PROJECT_SOURCE_DIR} ${CMAKE_BINARY_DIR})
set_tests_properties(report.kit PROPERTIES TIMEOUT 600)
